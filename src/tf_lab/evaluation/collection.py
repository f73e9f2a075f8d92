"""The metrics as torchmetrics: the means over scenes, whichever process scored them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torchmetrics import Metric, MetricCollection

from tf_lab.evaluation.metrics import Comparison
from tf_lab.evaluation.registry import METRICS, with_paper
from tf_lab.evaluation.scores import value

EXACT = torch.float32 if torch.backends.mps.is_available() else torch.float64  # MPS has no double


class SceneMean(Metric):
    """Mean of one metric over scenes; a sum and a count, which processes add up.

    Args:
        settings: of the metric.
    """

    full_state_update = False
    is_differentiable = False
    total: Tensor
    scenes: Tensor

    def __init__(self, settings: Any) -> None:
        super().__init__()
        self.settings = settings
        self.add_state("total", torch.zeros((), dtype=EXACT), dist_reduce_fx="sum")
        self.add_state("scenes", torch.zeros((), dtype=torch.int64), dist_reduce_fx="sum")

    @property
    def higher_is_better(self) -> bool | None:  # type: ignore[override]
        """Which way the metric is better."""
        return METRICS.named(self.settings).higher_is_better

    def update(self, found: Comparison | float | None) -> None:
        """Count a scene, or its score; None: its reconstruction is missing or empty."""
        self.total += found if isinstance(found, float) else value(found, self.settings)
        self.scenes += 1

    def compute(self) -> Tensor:
        """The mean over the scenes of all processes, NaN without any."""
        return self.total / self.scenes


def scene_means(metrics: Sequence[Any] = ()) -> MetricCollection:
    """The paper's metrics and ``metrics`` (their settings) as one collection, by name."""
    parts = {METRICS.named(each).name: SceneMean(each) for each in with_paper(metrics)}
    # groups of equal states are not looked for: two scores may be equal by chance
    return MetricCollection(dict(parts), compute_groups=False)
