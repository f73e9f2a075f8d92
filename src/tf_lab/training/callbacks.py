"""Callbacks of a training: its progress on the screen, and which code worked on it how long."""

from __future__ import annotations

import time
from typing import Any

import lightning as L
from lightning.pytorch.callbacks import Callback
from rich.progress import Progress, TaskID

from tf_lab.experiments.provenance import commits_of, provenance
from tf_lab.support.progress import Once, Pace, progress_bar
from tf_lab.training.clusters import is_helper

SHOWN = 0.5  # seconds between looks at the losses, for which a GPU has to be waited for


class _Progress(Callback):
    """A progress bar of the first process."""

    def __init__(self) -> None:
        self.bar: Progress | None = None
        self.task = TaskID(0)

    def _start(self, trainer: L.Trainer, what: str, total: float, completed: int = 0) -> None:
        if trainer.is_global_zero:
            self.bar = progress_bar()
            self.bar.start()
            self.task = self.bar.add_task(what, total=total, completed=completed)

    def _stop(self) -> None:
        if self.bar is not None:
            self.bar.stop()
            self.bar = None

    def on_exception(
        self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException
    ) -> None:
        """Give the terminal back."""
        self._stop()


class EvaluationProgress(_Progress):
    """Shows how many of its scenes the first process has tested, and the newest F-score.

    Of the scene at work it shows how many keyframes it has, and when it is meshed.
    """

    def __init__(self) -> None:
        super().__init__()
        self.last = ""

    def on_test_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Show the bar."""
        self._start(trainer, "testing", total=trainer.num_test_batches[0])

    def on_test_batch_end(
        self,
        trainer: L.Trainer,
        pl_module: L.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Count a scene."""
        if self.bar is not None:
            self.last = f", last F {outputs['fscore']:.3f}"
            text = f"testing{self.last}"
            self.bar.update(self.task, advance=1, description=text)

    def tell(self, text: str) -> None:
        """Say where in a scene the work is."""
        if self.bar is not None:
            self.bar.update(self.task, description=f"testing {text}{self.last}")

    def on_test_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Leave the finished bar on the screen."""
        self._stop()


class TrainingProgress(_Progress):
    """Shows the steps that are done, the losses and the time left."""

    def __init__(self) -> None:
        super().__init__()
        self.pace = Pace()
        self.shown = -SHOWN

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Start at the step the run is at."""
        self._start(trainer, "training", trainer.max_steps, trainer.global_step)

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
        if self.bar is None or early:
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

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Leave the finished bar on the screen."""
        self._stop()


class TrainingSessions(Callback):
    """How long a training took and which code did it, over all the times it was resumed."""

    def __init__(self) -> None:
        self.origin = provenance()  # of the code that trains, not of what HEAD becomes
        self.start = time.time()
        self.earlier: list[dict[str, Any]] = []

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        seconds = round(time.time() - self.start, 1)
        this = {"commit": self.origin["commit"], "code": self.origin["code"], "seconds": seconds}
        return {"sessions": [*self.earlier, this]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on; say so if another code began."""
        self.earlier = state_dict["sessions"]
        if not is_helper() and any(e["code"] != self.origin["code"] for e in self.earlier):
            print(f"note: another code began this training (commit {commits_of(self.earlier)})")

    def summary(self) -> dict[str, Any]:
        """The provenance of the training."""
        sessions = self.state_dict()["sessions"]
        seconds = round(sum(session["seconds"] for session in sessions), 1)
        return {**self.origin, "seconds": seconds, "sessions": sessions}
