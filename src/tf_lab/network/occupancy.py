"""Surface occupancy S: interpolated coarse and fine features to occupancy (paper, Sec. 3.3)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

MODULES = 3  # in the paper


class FeedForward(nn.Module):
    """Layer norm, ReLU, linear layer, residual connection."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.linear = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        """[..., D] -> [..., D]."""
        return x + self.linear(torch.relu(self.norm(x)))


class OccupancyMLP(nn.Module):
    """Three feed-forward modules between an input and an output layer.

    Args:
        width: D of the refined features.
        hidden: width of the modules.
    """

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.input = nn.Linear(2 * width, hidden)
        self.feed_forward = nn.Sequential(*(FeedForward(hidden) for _ in range(MODULES)))
        self.output = nn.Linear(hidden, 1)

    def forward(self, coarse: Tensor, fine: Tensor) -> Tensor:
        """Features [..., D] and [..., D] of points to occupancy logits [...] (> 0: solid)."""
        x = self.input(torch.cat([coarse, fine], dim=-1))
        return self.output(self.feed_forward(x)).squeeze(-1)
