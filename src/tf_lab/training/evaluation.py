"""Evaluation by Lightning: scenes are shared by the processes, their scores put together."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch.distributed
from torch import Tensor
from torch.utils.data import DataLoader

from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.evaluation.collection import scene_means
from tf_lab.evaluation.protocol import PublishedGroundTruth, compared, read_groundtruth
from tf_lab.evaluation.registry import METRICS, with_paper
from tf_lab.evaluation.scenes import (
    SceneResult,
    kept_scene,
    save_scene,
    scene_truth,
    write_metrics,
)
from tf_lab.evaluation.scores import Scores
from tf_lab.experiments.provenance import code_version
from tf_lab.network.network import Network
from tf_lab.online.reconstruction import Reconstruction, reconstruct
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.support.stops import as_parent
from tf_lab.training.callbacks import EvaluationProgress
from tf_lab.training.clusters import check_processes, cluster_plugins, telling_lost_processes


def scene_loader(scenes: Sequence[Path], trainer: L.Trainer | None) -> DataLoader[Path | None]:
    """The scenes that are this process's, one at a time; no other process has them.

    Where there are fewer scenes than processes, a process without any gets None: Lightning lets
    one that has nothing to do pass by the end of the epoch, where the others wait for it.
    """
    rank, world = (0, 1) if trainer is None else (trainer.global_rank, trainer.world_size)
    own: list[Path | None] = [*scenes[rank::world]] or [None]
    return DataLoader(own, batch_size=None)  # type: ignore[arg-type]


class SceneSplit(L.LightningDataModule):
    """The scenes of a test, shared by the processes."""

    def __init__(self, scenes: Sequence[Path]) -> None:
        super().__init__()
        self.scenes = scenes

    def test_dataloader(self) -> DataLoader[Path | None]:
        """Scene directories, one at a time."""
        return scene_loader(self.scenes, self.trainer)


class SceneEvaluation(L.LightningModule):
    """Reconstructs whole scenes and scores them; the means are over the scenes of all processes.

    Processes wait for each other at the end of an epoch only, however many scenes each has.

    Args:
        network: what reconstructs.
        settings: how.
        metrics: settings of metrics beyond the paper's.
        run: where a test writes ``metrics.json``, meshes and pictures.
        label: the row's name.
        groundtruth: what test scenes are scored by, a folder in the published layout; None: by
            their own.

    Attributes:
        tell: if set, is told where in a scene the work is.
    """

    def __init__(
        self,
        network: Network,
        settings: ReconstructionSettings,
        metrics: Sequence[Any] = (),
        run: Path | None = None,
        label: str = "",
        groundtruth: Path | None = None,
    ) -> None:
        super().__init__()
        self.network, self.capture_settings = network, settings
        self.scores = scene_means(metrics)
        self.names = [METRICS.named(each).name for each in with_paper(metrics)]
        self.run, self.label, self.groundtruth = run, label, groundtruth
        self.tell: Callable[[str], None] | None = None
        self.results: dict[str, SceneResult] = {}

    def validation_step(self, directory: Path | None, batch_idx: int) -> None:
        """Reconstruct and score a scene of the val split."""
        if directory is not None:
            scene = Scene(directory)
            self._score(scene, read_groundtruth(scene.groundtruth), color=False)

    def on_validation_epoch_end(self) -> None:
        """Log the means over all scenes as ``val/<metric>``."""
        self.log_dict({f"val/{k}": v for k, v in self._means().items()}, sync_dist=True)

    def on_test_start(self) -> None:
        """Forget an earlier test."""
        self.results = {}

    def test_step(self, directory: Path | None, batch_idx: int) -> Scores | None:
        """Reconstruct and score a scene of the test split; write its mesh and picture.

        A scene that a stopped test of the same code came to the end of is not done again.
        """
        if directory is None:
            return None
        assert self.run is not None
        scene, code = Scene(directory), code_version()
        if scene.name in self.results:
            raise TFLabError(
                f"{directory}: a second test scene that calls itself {scene.name}; remove that "
                "folder and prepare it again"
            )
        kept = kept_scene(self.run, scene.name, code)
        if kept is None:
            truth = scene_truth(scene, self.groundtruth)
            result, scores, seconds = self._score(scene, truth)
            kept = save_scene(result, scene, truth.mesh, scores, seconds, self.run, code)
        else:
            for name in self.names:
                self.scores[name].update(kept.scores[name])
        self.results[scene.name] = kept
        return kept.scores

    def on_test_epoch_end(self) -> None:
        """Put the scenes of all processes together; the first process writes the run's metrics."""
        mean, shares = self._means(), [self.results]
        self.log_dict({f"test/{k}": v for k, v in mean.items()}, sync_dist=True)
        if self.trainer.world_size > 1:
            shares = [{}] * self.trainer.world_size
            torch.distributed.all_gather_object(shares, self.results)
        if self.trainer.is_global_zero:
            assert self.run is not None
            results = in_turn(shares)
            seen = float(np.mean([r.details["median_views"] for r in results.values()]))
            print(f"the median surface point of a test scene is seen by {seen:.0f} keyframes")
            write_metrics(self.run, self.label, mean, results)

    def _score(
        self, scene: Scene, truth: PublishedGroundTruth, color: bool = True
    ) -> tuple[Reconstruction, Scores, float]:
        """A scene's reconstruction, its scores, and the seconds that reconstructing it took."""

        def show(done: int, total: int) -> None:
            if self.tell is not None:
                self.tell(f"{scene.name} " + ("meshing" if done == total else f"{done}/{total}"))

        start = time.time()
        result = reconstruct(self.network, scene, self.capture_settings, show, color)
        seconds = time.time() - start
        return result, in_order(self.scores(compared(result.mesh, truth)), self.names), seconds

    def _means(self) -> Scores:
        """The means over the scenes of all processes; the next epoch starts anew."""
        means = in_order(self.scores.compute(), self.names)
        self.scores.reset()
        return means


def in_order(found: Mapping[str, Tensor], names: Sequence[str]) -> Scores:
    """What a collection, which sorts its metrics, computed, in the order of the tables."""
    return {name: float(found[name]) for name in names}


def in_turn(shares: Sequence[Mapping[str, SceneResult]]) -> dict[str, SceneResult]:
    """The results of all processes in the order of the scenes, which they had in turn."""
    rounds = zip_longest(*(share.items() for share in shares))
    return dict(pair for pairs in rounds for pair in pairs if pair is not None)


def evaluate_network(module: SceneEvaluation, scenes: Sequence[Path], **devices: Any) -> None:
    """Test a network on scenes; write ``metrics.json``, meshes and pictures to the module's run.

    Args:
        module: the network, in evaluation mode, and how to reconstruct.
        scenes: scene directories with ground truth; at least one.
        devices: of the trainer: accelerator, devices, num_nodes, strategy.
    """
    progress = EvaluationProgress()
    module.tell = progress.tell
    trainer = L.Trainer(
        **devices,
        default_root_dir=module.run,
        plugins=cluster_plugins(),
        callbacks=[progress],
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        use_distributed_sampler=False,
        inference_mode=False,  # as outside Lightning
    )
    check_processes(trainer)
    # of the other processes of a distributed test
    with as_parent(deaf=False), telling_lost_processes():
        trainer.test(module, datamodule=SceneSplit(scenes), verbose=False)


def first_says(decision: bool) -> bool:
    """The first process's decision, in every process of a distributed training."""
    said = [decision]
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        torch.distributed.broadcast_object_list(said)
    return said[0]
