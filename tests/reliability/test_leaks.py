"""Long runs hold no more memory and files in the end than when they were warm."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.online.scenes import FAR, Factory, balanced, settings_of
from helpers.resources import Use
from helpers.tiny_jobs import TINY, call
from tf_lab.data.scene import Scene
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.training.callbacks import TrainingProgress

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


def test_a_thousand_frames_and_fifty_meshes(tiny_network: Factory, box_scene: Path) -> None:
    """Of one reconstruction, whose feature maps have a budget: small images are all that grows."""
    scene = Scene(box_scene)
    network = balanced(tiny_network(far=FAR), scene)
    settings = settings_of(resolution=0.1, maps_budget=2**20)
    reconstructor = Reconstructor(network, settings)
    rng, use = np.random.default_rng(0), Use()
    K = np.diag([0.5, 0.5, 1.0]) @ scene.K[0]
    for i in range(1000):
        pose = scene.world_T_cam[i % len(scene)].copy()
        pose[:3, 3] += rng.uniform(-0.02, 0.02, 3)
        reconstructor.add_frame(scene.image(i % len(scene))[::2, ::2], K, pose)
        if i % 20 == 19:
            assert len(reconstructor.mesh().faces) > 0
            use.measure()
    use.assert_flat()


def test_five_hundred_steps_of_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use = Use()
    before = TrainingProgress.on_train_batch_end

    def measured(self: TrainingProgress, trainer: Any, *arguments: Any) -> None:
        before(self, trainer, *arguments)
        if trainer.global_step % 10 == 0:
            use.measure()

    monkeypatch.setattr(TrainingProgress, "on_train_batch_end", measured)
    words = (*TINY, "optimizer.steps=500", "data.test_size=0", "training.save_every=100")
    assert call("train", *words, f"output={tmp_path}").status == 0
    assert len(use.memory) == 50
    use.assert_flat()
