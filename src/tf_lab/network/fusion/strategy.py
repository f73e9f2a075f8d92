"""What a fusion strategy is."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from torch import Tensor, nn


class Fusion(nn.Module):
    """How the views of a voxel become one feature; see `tf_lab.network.fusion`.

    Attributes:
        ranks_views: whether it has `selection_logits`. Where it has none, what attention would
            choose is chosen by chance.
        ordered: whether the order of the views matters to it; then they come in that of time.

    Args:
        width: D.
        blocks, heads, expansion: of the transformer; strategies without one match its size.
    """

    ranks_views: ClassVar[bool]
    ordered: ClassVar[bool] = False

    def __init__(self, width: int, blocks: int, heads: int, expansion: float) -> None:
        super().__init__()

    @abstractmethod
    def forward(self, tokens: Tensor, slots: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Fused features [..., D] and weights [..., K] of views [..., K, D]."""

    def selection_logits(self, tokens: Tensor) -> Tensor:
        """What the weights are made of, [..., K, H]; never asked of a strategy that does not rank.

        Raises:
            NotImplementedError: it does not rank views.
        """
        raise NotImplementedError
