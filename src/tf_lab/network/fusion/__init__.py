"""Fusion strategies: how the views of a voxel become one feature. One signature for all.

``forward(tokens [..., K, D], slots [..., K] or None) -> (fused [..., D], weights [..., K])``:
``slots`` tells which of the K slots hold a measurement (None: all); weights are at least 0, sum to
1 over the filled slots (to 0 where none is filled) and are 0 in empty ones.

``selection_logits(tokens [..., K, D]) -> [..., K, H] or None``: per view and head, what the weights
are made of; a view's logits depend on that view alone. None if the strategy has no preference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tf_lab.network.fusion.settings import (
    AverageSettings,
    PredictedSettings,
    TransformerSettings,
)
from tf_lab.support.registry import Part, Registry

if TYPE_CHECKING:
    from tf_lab.network.fusion.strategy import Fusion


@dataclass(frozen=True)
class FusionPart(Part):
    """A fusion strategy by name.

    Attributes:
        label: how a row of the tables tells it from the paper's transformer.
    """

    label: str = ""


FUSIONS: Registry[FusionPart] = Registry("fusion", "strategy")
FUSIONS.add(
    FusionPart(
        "transformer", "tf_lab.network.fusion.transformer:TransformerFusion", TransformerSettings
    )
)
FUSIONS.add(
    FusionPart(
        "avg", "tf_lab.network.fusion.mlp:AverageFusion", AverageSettings, label="w/o TRSF, avg"
    )
)
FUSIONS.add(
    FusionPart(
        "pred",
        "tf_lab.network.fusion.mlp:PredictedFusion",
        PredictedSettings,
        label="w/o TRSF, pred",
    )
)


def make_fusion(settings: Any, width: int, blocks: int, heads: int, expansion: float) -> Fusion:
    """The strategy that settings (or a name, or a mapping) describe; sizes as of `Fusion`.

    Raises:
        TFLabError: there is none.
    """
    return FUSIONS.make(settings, width, blocks, heads, expansion)
