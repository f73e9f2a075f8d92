"""What a fusion strategy is."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import torch
from torch import Tensor, nn

from tf_lab.errors import TFLabError


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


def check_outputs(strategy: Fusion, width: int) -> None:
    """Try a strategy on two voxels of three views; what else it promises `contract` checks.

    Raises:
        TFLabError: it gives no features or weights, some of another shape, or weights that do not
            sum to 1.
    """
    if torch.get_default_device().type == "meta":
        return  # of shapes alone, which not all operations know
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        given = strategy.eval()(torch.zeros(2, 3, width))
    strategy.train()
    name = type(strategy).__name__
    wanted = {"features": (2, width), "weights": (2, 3)}
    if not (isinstance(given, tuple) and len(given) == 2):
        raise TFLabError(f"{name} gives no pair (features, weights)")
    for value, (what, shape) in zip(given, wanted.items(), strict=True):
        if tuple(value.shape) != shape:
            raise TFLabError(
                f"{name} gives {what} of {tuple(value.shape)}, for views of (2, 3, {width}): "
                f"{shape} is wanted"
            )
    sums = given[1].sum(-1)
    if (sums - 1).abs().max() > 1e-3:
        raise TFLabError(f"{name} gives weights that sum to {sums[0]:.4g}, not to 1")
