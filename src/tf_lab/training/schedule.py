"""Learning rates over their peak, by step."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler

from tf_lab.config.groups import OptimizerSettings

WARMUP = 50  # steps, of pre-training
DECAY = 0.2  # share of the steps in which warmup_stable_decay falls


def learning_rate_factor(settings: OptimizerSettings, step: int) -> float:
    """The learning rate at a step (from 0) over the peak, as ``optimizer.schedule`` says.

    Linear warm-up, then the inverse square root of the step (paper, Sec. 3.5), half a cosine, or
    the peak until a linear fall to 0 over the last fifth (warmup-stable-decay, Hu et al. 2024): a
    training of more steps can go on from any state before the fall, by ``init=``.
    """
    warmup = max(1, settings.warmup)
    warm = min(1.0, (step + 1) / warmup)
    if settings.schedule == "inverse_sqrt":
        return warm * (warmup / max(step + 1, warmup)) ** 0.5
    if settings.schedule == "warmup_stable_decay":
        return min(warm, (settings.steps - step) / max(1, DECAY * settings.steps))
    done = max(0, step - settings.warmup) / max(1, settings.steps - settings.warmup)
    return warm * half_cosine(min(1.0, done))


def scheduled(
    optimizer: torch.optim.Optimizer, factor: Callable[[int], float]
) -> OptimizerLRScheduler:
    """An optimizer whose learning rate is its peak times a factor of the step, for Lightning."""
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, factor)
    return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def warm_cosine(step: int, steps: int) -> float:
    """Half a cosine over all steps, the first `WARMUP` of which warm up linearly."""
    return min(1.0, (step + 1) / WARMUP) * half_cosine(step / steps)


def half_cosine(done: float) -> float:
    """From 1 (at 0) to 0 (at 1)."""
    return 0.5 * (1 + math.cos(math.pi * done))
