"""A training whose numbers go wrong stops there, and its last good checkpoint stays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import lightning as L
import torch
from lightning.pytorch.callbacks import Callback
from torch import Tensor
from torch.nn.utils import get_total_norm

from tf_lab.errors import TFLabError
from tf_lab.network.finite import not_finite

NORM = "gradient norm"
LEAST_SCALE = 1.0  # of a loss in float16: less is only come to by overflow after overflow


@dataclass(frozen=True)
class _Step:
    """What was seen in a step: the values are on their way from the device until the event."""

    number: int
    rate: float
    scenes: Sequence[str]
    names: Sequence[str]
    values: Tensor
    copied: torch.cuda.Event | None

    def wrong(self) -> str:
        """What is not finite, with all else that was seen; nothing if all is."""
        if self.copied is not None:
            self.copied.synchronize()
        values = dict(zip(self.names, self.values.tolist(), strict=True))
        if all(map(math.isfinite, values.values())):
            return ""
        seen = ", ".join(f"{name} {value:.4g}" for name, value in values.items())
        scenes = f"; scenes {', '.join(sorted(set(self.scenes)))}" if self.scenes else ""
        return (
            f"step {self.number}: its numbers are not finite ({seen}; learning rate "
            f"{self.rate:.3g}{scenes})"
        )


class Finite(Callback):
    """Stops a training at the first step whose loss or gradient is not finite.

    A GPU is not waited for: its numbers of a step are looked at after the next one was started, or
    before anything is saved.

    Args:
        last: the checkpoint that is kept.
    """

    def __init__(self, last: Path) -> None:
        self.last = last
        self._step: _Step | None = None
        self._rate = 0.0
        self._norm: Tensor | None = None

    def on_before_optimizer_step(
        self, trainer: L.Trainer, pl_module: L.LightningModule, optimizer: torch.optim.Optimizer
    ) -> None:
        """See the gradient as it is before it is clipped, and the learning rate."""
        self._rate = optimizer.param_groups[0]["lr"]
        if getattr(trainer.precision_plugin, "scaler", None) is None:  # which skips such steps
            gradients = [p.grad for p in pl_module.parameters() if p.grad is not None]
            self._norm = get_total_norm(gradients)

    def on_train_batch_end(
        self,
        trainer: L.Trainer,
        pl_module: L.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
    ) -> None:
        """Look at the step before, or where that costs nothing at this one."""
        terms = outputs if isinstance(outputs, Mapping) else {"loss": outputs}
        seen = {k: v for k, v in {**terms, NORM: self._norm}.items() if isinstance(v, Tensor)}
        values = torch.stack([v.detach().float() for v in seen.values()])
        before, copied = self._step, None
        if values.is_cuda:
            values, copied = values.to("cpu", non_blocking=True), torch.cuda.Event()
            copied.record()
        scenes = getattr(batch, "scenes", ())
        self._step = _Step(trainer.global_step, self._rate, scenes, [*seen], values, copied)
        self._check(before if copied is not None else self._step)

    def on_save_checkpoint(
        self, trainer: L.Trainer, pl_module: L.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Save nothing that is wrong."""
        self._check(self._step)
        self._check_scale(trainer)
        if wrong := not_finite(checkpoint["state_dict"]):
            self._end(f"step {trainer.global_step}: the weights are not finite (first: {wrong[0]})")

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Look at the last step."""
        self._check(self._step)
        self._check_scale(trainer)

    def _check(self, step: _Step | None) -> None:
        wrong = step.wrong() if step is not None else ""
        if wrong:
            self._end(wrong)

    def _check_scale(self, trainer: L.Trainer) -> None:
        """That steps were taken: the scaler of ``16-mixed`` skips those that overflow."""
        scaler = getattr(trainer.precision_plugin, "scaler", None)
        scale = math.inf if scaler is None else scaler.get_scale()
        if scale < LEAST_SCALE:
            self._end(
                f"step {trainer.global_step}: most steps were skipped, as gradients overflow "
                f"float16 even of the loss times {scale:.1g}",
                "use trainer.precision=bf16-mixed or 32-true",
            )

    def _end(
        self, wrong: str, cure: str = "try a lower learning rate or stronger clipping"
    ) -> NoReturn:
        kept = f"{self.last} is kept" if self.last.exists() else "there is no checkpoint yet"
        raise TFLabError(f"{wrong}; {kept}; {cure}")
