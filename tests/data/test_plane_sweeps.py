"""Frames drawn to learn depth from stereo: which views they are compared with, and what is true."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from tf_lab.data.plane_sweeps import SweepBatch, SweepDraws, SweepStream, every_sweep
from tf_lab.data.resize import Resized
from tf_lab.data.scene import Scene
from tf_lab.data.settings import CameraNoise, PhotometricSettings
from tf_lab.errors import TFLabError
from tf_lab.stereo.depth import StereoSettings, depth_of, small_view
from tf_lab.stereo.regularizer import read_depth, shipped_regularizer

PLAIN = SweepDraws(3, CameraNoise(), PhotometricSettings())
SMALL = StereoSettings(width=16, planes=8)


def batches(scene: Path, draws: SweepDraws, first: int = 0, seed: int = 0) -> list[SweepBatch]:
    stream = iter(SweepStream([scene], SMALL, draws, seed, first))
    return [next(stream) for _ in range(2)]


def test_a_batch_is_a_function_of_seed_and_step(box_scene: Path) -> None:
    first, second = batches(box_scene, PLAIN)
    again = batches(box_scene, PLAIN, first=1)[0]
    assert torch.equal(second.scores, again.scores) and torch.equal(second.depth, again.depth)
    assert not torch.equal(first.depth, second.depth)
    assert not torch.equal(batches(box_scene, PLAIN, seed=1)[0].depth, first.depth)


def test_depth_is_the_scenes_own(box_scene: Path) -> None:
    """Nearest readings of the true depth maps, at the sweep's size."""
    scene = Scene(box_scene)
    true = [Resized(scene, (16, 12)).depth(i) for i in range(len(scene))]
    batch = batches(box_scene, PLAIN)[0]
    assert batch.scores.shape == (3, 8, 12, 16)
    for depth in batch.depth.numpy():
        assert any(np.array_equal(depth, other) for other in true)


def test_cameras_and_images_are_disturbed_as_told(box_scene: Path) -> None:
    plain = batches(box_scene, PLAIN)[0]
    wrong = SweepDraws(3, CameraNoise(translation=0.05), PhotometricSettings())
    noisy = SweepDraws(3, CameraNoise(), PhotometricSettings(noise=0.2))
    for draws in (wrong, noisy):
        other = batches(box_scene, draws)[0]
        assert torch.equal(other.depth[0], plain.depth[0])  # what is true stays true
        assert not torch.equal(other.scores[0], plain.scores[0])


def test_what_is_validated_is_what_a_frame_gets_online(box_scene: Path) -> None:
    """The same scores as of frames that come one by one; the first has no sources."""
    scene, settings = Scene(box_scene), StereoSettings()
    frames = [*range(len(scene))]
    found = every_sweep(scene, frames, frames[1:], settings)
    views = [small_view(scene.image(i), scene.K[i], scene.world_T_cam[i], 80) for i in frames]
    inverse = torch.from_numpy(settings.inverse).float()
    online = {i: depth_of(views, i, settings) for i in frames[1:]}
    online = {i: maps for i, maps in online.items() if maps.any()}
    assert len(found) == len(online) > 0
    for batch, (i, maps) in zip(found, online.items(), strict=True):
        true = Resized(scene, (maps.shape[2], maps.shape[1])).depth(i)
        np.testing.assert_array_equal(batch.depth[0].numpy(), true)
        with torch.inference_mode():
            depth, confidence = read_depth(shipped_regularizer()(batch.scores), inverse)
        np.testing.assert_allclose(depth[0].numpy(), maps[0], rtol=1e-4)
        np.testing.assert_allclose(confidence[0].numpy(), maps[1], atol=1e-4)


def test_scenes_that_say_nothing_are_told(tmp_path: Path, box_scene: Path) -> None:
    with pytest.raises(TFLabError, match="no scene to pre-train on"):
        SweepStream([], SMALL, PLAIN, 0)
    far = StereoSettings(width=16, planes=8, baseline=(90.0, 99.0, 95.0))
    told = "hardly a frame of the scenes has depth and others that overlap it"
    with pytest.raises(TFLabError, match=told):
        next(iter(SweepStream([box_scene], far, PLAIN, 0)))
    shutil.copytree(box_scene, tmp_path / "bare")
    shutil.rmtree(tmp_path / "bare" / "depth")
    with pytest.raises(TFLabError, match=told):
        next(iter(SweepStream([tmp_path / "bare"], SMALL, PLAIN, 0)))
