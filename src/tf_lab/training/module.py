"""The LightningModule of training: losses, optimiser, schedule."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import Callback
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from rich.progress import Progress, TaskID
from torch import Tensor

from tf_lab.config.groups import OptimizerSettings
from tf_lab.data.chunks import COARSE_GRID, FINE_GRID, ChunkBatch
from tf_lab.experiments.provenance import provenance
from tf_lab.experiments.reuse import commits_of
from tf_lab.network.network import Network
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.online.views import make_policy
from tf_lab.online.views.batch import BatchSelection
from tf_lab.support.progress import Once, Pace, progress_bar
from tf_lab.training.evaluation import SceneEvaluation
from tf_lab.training.known_maps import KnownMaps
from tf_lab.training.losses import losses


def schedule_factor(settings: OptimizerSettings, step: int) -> float:
    """The learning rate at a step (from 0) over the peak."""
    warm = min(1.0, (step + 1) / max(1, settings.warmup))
    if settings.schedule == "inverse_sqrt":
        return warm * (max(1, settings.warmup) / max(step + 1, settings.warmup, 1)) ** 0.5
    done = max(0, step - settings.warmup) / max(1, settings.steps - settings.warmup)
    cosine = 0.5 * (1 + torch.cos(torch.tensor(min(1.0, done) * torch.pi)).item())
    return warm * cosine


class Training(SceneEvaluation):
    """Trains a network on chunks; validates it on whole scenes.

    Args:
        network: what is trained.
        optimizer: see `OptimizerSettings`.
        sdf_weight: of the signed-distance loss (0 in the paper).
        test: test-time settings of validation.
        maps_memory: bytes of feature maps to keep if the encoder is frozen.
        metrics: settings of metrics of validation beyond the paper's.
    """

    def __init__(
        self,
        network: Network,
        optimizer: OptimizerSettings,
        sdf_weight: float,
        test: ReconstructionSettings,
        maps_memory: int = 0,
        metrics: Sequence[Any] = (),
    ) -> None:
        super().__init__(network, test, metrics)
        self.optimizer_settings, self.sdf_weight = optimizer, sdf_weight
        frozen = optimizer.encoder_factor == 0
        self.known_maps = KnownMaps(network, maps_memory) if frozen else None
        self.save_hyperparameters(
            {
                "network": asdict(network.config),
                "optimizer": asdict(optimizer),
                "sdf_weight": sdf_weight,
            }
        )

    def training_step(self, batch: ChunkBatch, batch_idx: int) -> Tensor:
        """L = L_c + L_f + L_o of a batch."""
        known = self.known_maps
        predictions = self.network(
            batch.images,
            batch.K,
            batch.world_T_cam,
            COARSE_GRID,
            FINE_GRID,
            batch.points,
            batch.coarse_target,
            keep=kept_by(batch),
            maps=None if known is None else known(batch.images.flatten(0, 1)),
        )
        terms = losses(
            predictions,
            batch.coarse_target,
            batch.fine_target,
            batch.sdf,
            use_masks=self.network.config.filter,
            sdf_weight=self.sdf_weight,
        )
        self.log_dict(
            {f"train/{k}": v.detach() for k, v in terms.items()},
            batch_size=len(batch.images),
            sync_dist=True,
        )
        return terms["loss"]

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Adam with a per-step schedule."""
        s = self.optimizer_settings
        encoder = [p for p in self.network.encoder.parameters() if p.requires_grad]
        others = [p for n, p in self.network.named_parameters() if not n.startswith("encoder.")]
        groups: list[dict[str, Any]] = [
            {"params": others},
            {"params": encoder, "lr": s.lr * s.encoder_factor},
        ]
        adam = torch.optim.Adam(groups, s.lr, s.betas, s.eps, s.weight_decay)
        schedule = torch.optim.lr_scheduler.LambdaLR(adam, partial(schedule_factor, s))
        return {
            "optimizer": adam,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }


def kept_by(batch: ChunkBatch) -> BatchSelection | None:
    """What chooses the views that voxels keep in a step; None: they keep all."""
    if not batch.keep:
        return None
    return BatchSelection(make_policy(batch.rule, 0), batch.keep, batch.draws)


SHOWN = 0.5  # seconds between looks at the losses, for which a GPU has to be waited for


class TrainingProgress(Callback):
    """A progress bar over all steps, with the losses and the time left."""

    def __init__(self) -> None:
        self.bar: Progress | None = None
        self.task: TaskID | None = None
        self.pace = Pace()
        self.shown = -SHOWN

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Start at the step the run is at."""
        if trainer.is_global_zero:
            self.bar = progress_bar()
            self.bar.start()
            self.task = self.bar.add_task(
                "training", total=trainer.max_steps, completed=trainer.global_step
            )

    def on_train_batch_end(
        self,
        trainer: L.Trainer,
        pl_module: L.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
    ) -> None:
        """Show the newest losses."""
        now, step = time.monotonic(), trainer.global_step
        early = now - self.shown < SHOWN and step < trainer.max_steps
        if self.bar is None or self.task is None or early:
            return
        self.shown = now
        values = trainer.callback_metrics
        names = {"train/coarse": "coarse", "train/fine": "fine", "train/occupancy": "occ"}
        text = " ".join(f"{n} {float(values[k]):.2f}" for k, n in names.items() if k in values)
        if "val/fscore" in values:
            text += f" val F {float(values['val/fscore']):.2f}"
        known = getattr(pl_module, "known_maps", None)
        work = Once(known.asked, known.encoded, known.seconds) if known is not None else Once()
        left = self.pace.left(now, step, int(trainer.max_steps), work)
        self.bar.update(self.task, completed=step, left=left, description=f"train {text}")

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Don't take a validation for a slow step."""
        self.pace.restart()

    def _stop(self) -> None:
        if self.bar is not None:
            self.bar.stop()
            self.bar = None

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Leave the finished bar on the screen."""
        self._stop()

    def on_exception(
        self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException
    ) -> None:
        """Give the terminal back."""
        self._stop()


class Sittings(Callback):
    """How long a training took and which code did it, over all the times it was resumed."""

    def __init__(self) -> None:
        self.origin = provenance()  # of the code that trains, not of what HEAD becomes
        self.start = time.time()
        self.earlier: list[dict[str, Any]] = []

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        seconds = round(time.time() - self.start, 1)
        this = {"commit": self.origin["commit"], "code": self.origin["code"], "seconds": seconds}
        return {"sittings": [*self.earlier, this]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on; say so if another code began."""
        self.earlier = state_dict["sittings"]
        if any(past["code"] != self.origin["code"] for past in self.earlier):
            print(f"note: another code began this training (commit {commits_of(self.earlier)})")

    def summary(self) -> dict[str, Any]:
        """The provenance of the training."""
        sittings = self.state_dict()["sittings"]
        seconds = round(sum(sitting["seconds"] for sitting in sittings), 1)
        return {**self.origin, "seconds": seconds, "sittings": sittings}
