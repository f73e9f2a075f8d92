"""Fusion strategies: how the views of a voxel become one feature. One signature for all.

``forward(tokens [..., K, D], slots [..., K] or None) -> (fused [..., D], weights [..., K])``:
``slots`` tells which of the K slots hold a measurement (None: all); weights are at least 0, sum to
1 over the filled slots (to 0 where none is filled) and are 0 in empty ones. What empty slots hold
has no influence, and any of the K may be empty.

``ranks_views`` says whether ``selection_logits(tokens [..., K, D]) -> [..., K, H]`` is there: per
view and head, what the weights are made of. A view's logits depend on that view alone, because they
are computed once, when a frame comes. A strategy that does not rank gets views chosen by chance.

The order of the views. A slot is filled by the frame that came when it was free, and later by the
one that took its place, so that the slots of a voxel are in no order. A strategy to which order
matters says ``ordered = True``: its views then come in the order of time, as the frames of a
capture are numbered, in training as at test time, empty slots last. One that says nothing must not
depend on it.

`contract` has the checks of all this that every registered strategy is run through.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tf_lab.network.fusion.settings import (
    AverageSettings,
    GRUSettings,
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
_HERE = "tf_lab.network.fusion"
for _part in (
    FusionPart("transformer", f"{_HERE}.transformer:TransformerFusion", TransformerSettings),
    FusionPart("avg", f"{_HERE}.mlp:AverageFusion", AverageSettings, label="w/o TRSF, avg"),
    FusionPart("pred", f"{_HERE}.mlp:PredictedFusion", PredictedSettings, label="w/o TRSF, pred"),
    FusionPart("gru", f"{_HERE}.gru:GRUFusion", GRUSettings, label="w/o TRSF, GRU (ours)"),
):
    FUSIONS.add(_part)


def make_fusion(settings: Any, width: int, blocks: int, heads: int, expansion: float) -> Fusion:
    """The strategy that settings (or a name, or a mapping) describe; sizes as of `Fusion`.

    Raises:
        TFLabError: there is none.
    """
    return FUSIONS.make(settings, width, blocks, heads, expansion)
