"""From per-view logits to view weights, the same for every strategy."""

from __future__ import annotations

import torch
from torch import Tensor


def weights_from_logits(logits: Tensor, slots: Tensor | None) -> Tensor:
    """Softmax over the filled slots, averaged over heads.

    Args:
        logits: [..., K, H].
        slots: bool [..., K], which slots are filled; None: all.

    Returns:
        [..., K], 0 in empty slots; sums to 1, or to 0 where no slot is filled.
    """
    logits = logits.float()
    if slots is None:
        return torch.softmax(logits, dim=-2).mean(-1)
    logits = logits.masked_fill(~slots.unsqueeze(-1), -torch.inf)
    weights = torch.softmax(logits, dim=-2).mean(-1)
    return weights.masked_fill(~slots, 0.0)  # also where no slot is filled: softmax gives NaN


def weighted_sum(features: Tensor, weights: Tensor) -> Tensor:
    """sum_i w_i x_i over the views: [..., K, D], [..., K] -> [..., D]."""
    return torch.einsum("...kd,...k->...d", features, weights.to(features.dtype))
