"""Fusion by a recurrent network that reads the views in the order of time (ours).

A worked example of a strategy: see docs/extending.md.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from tf_lab.network.fusion.strategy import Fusion
from tf_lab.network.fusion.weights import weighted_sum, weights_from_logits


class GRUFusion(Fusion):
    """A GRU (Cho et al. 2014) over the views; psi is the mean of its states by predicted weights.

    What a state says of a view takes the earlier ones into account; its weight does not, so that
    views can be ranked one by one.

    Args:
        width: D.
        blocks, heads, expansion: of the transformer, whose parameter count it matches.
        layers: recurrent layers.
    """

    ranks_views = True
    ordered = True

    def __init__(
        self, width: int, blocks: int, heads: int, expansion: float, layers: int = 2
    ) -> None:
        super().__init__(width, blocks, heads, expansion)
        # a layer of h states has 6 h^2 weights, the way in and out 2 D h: as many as the blocks
        wanted = blocks * (4 + 2 * expansion) * width**2
        states = round((math.sqrt(width**2 + 6 * layers * wanted) - width) / (6 * layers))
        self.input = nn.Linear(width, states)
        self.gru = nn.GRU(states, states, layers, batch_first=True)
        self.output = nn.Linear(states, width)
        self.score = nn.Linear(width, 1)
        self.norm = nn.LayerNorm(width)

    def selection_logits(self, tokens: Tensor) -> Tensor:
        """Predicted logits [..., K, 1] of views [..., K, D]."""
        return self.score(tokens)

    def forward(self, tokens: Tensor, slots: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `tf_lab.network.fusion`."""
        weights = weights_from_logits(self.selection_logits(tokens), slots)
        if slots is None:
            slots = torch.ones_like(tokens[..., 0], dtype=torch.bool)
        # the filled slots first, in their order: no state of theirs has seen an empty one
        order = (~slots).int().argsort(dim=-1, stable=True)
        x = torch.take_along_dim(self.input(tokens), order.unsqueeze(-1), dim=-2)
        with torch.autocast(x.device.type, enabled=False):  # which not every GRU kernel knows
            states, _ = self.gru(x.float().reshape(-1, *x.shape[-2:]))
        read = self.output(states.view_as(x))
        return self.norm(weighted_sum(read, weights.gather(-1, order))), weights
