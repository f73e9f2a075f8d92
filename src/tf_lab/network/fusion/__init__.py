"""Fusion strategies: how the views of a voxel become one feature. One signature for all.

``forward(tokens [..., K, D], slots [..., K] or None) -> (fused [..., D], weights [..., K])``:
``slots`` tells which of the K slots hold a measurement (None: all); weights are at least 0, sum to
1 over the filled slots (to 0 where none is filled) and are 0 in empty ones.

``selection_logits(tokens [..., K, D]) -> [..., K, H] or None``: per view and head, what the weights
are made of; a view's logits depend on that view alone. None if the strategy has no preference.
"""

from __future__ import annotations

from tf_lab.network.fusion.mlp import AverageFusion, PredictedFusion
from tf_lab.network.fusion.strategy import Fusion
from tf_lab.network.fusion.transformer import TransformerFusion
from tf_lab.network.fusion.weights import weights_from_logits

STRATEGIES: dict[str, type[Fusion]] = {
    "transformer": TransformerFusion,
    "avg": AverageFusion,
    "pred": PredictedFusion,
}

__all__ = [
    "STRATEGIES",
    "AverageFusion",
    "Fusion",
    "PredictedFusion",
    "TransformerFusion",
    "weights_from_logits",
]
