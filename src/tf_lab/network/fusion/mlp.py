"""Fusion by averaging what a multi-layer perceptron makes of each view (paper, Sec. 4.2).

The perceptrons have about the transformer's parameter count, so that the ablation compares ways of
fusing, not sizes.
"""

from __future__ import annotations

from torch import Tensor, nn

from tf_lab.network.fusion.strategy import Fusion
from tf_lab.network.fusion.weights import weighted_sum, weights_from_logits


class ViewMLP(nn.Module):
    """Residual feed-forward blocks on each view by itself: [..., D] -> [..., D].

    A transformer block has 4 D^2 (attention) and 2 e D^2 (feed-forward) weights; a block here has
    2 D h, so h = (2 + e) D makes them equal.
    """

    def __init__(self, width: int, blocks: int, expansion: float) -> None:
        super().__init__()
        hidden = round((2 + expansion) * width)
        self.blocks = nn.ModuleList(
            nn.Sequential(
                nn.LayerNorm(width), nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, width)
            )
            for _ in range(blocks)
        )

    def forward(self, x: Tensor) -> Tensor:
        """[..., D] -> [..., D]."""
        for block in self.blocks:
            x = x + block(x)
        return x


class AverageFusion(Fusion):
    """The mean of the views ("w/o TRSF, avg"). Has no preference among views."""

    ranks_views = False

    def __init__(self, width: int, blocks: int, heads: int, expansion: float) -> None:
        super().__init__(width, blocks, heads, expansion)
        self.mlp = ViewMLP(width, blocks, expansion)
        self.norm = nn.LayerNorm(width)

    def forward(self, tokens: Tensor, slots: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `tf_lab.network.fusion`."""
        weights = weights_from_logits(tokens.new_zeros(*tokens.shape[:-1], 1), slots)
        return self.norm(weighted_sum(self.mlp(tokens), weights)), weights


class PredictedFusion(Fusion):
    """A weighted mean with weights predicted per view ("w/o TRSF, pred")."""

    ranks_views = True

    def __init__(self, width: int, blocks: int, heads: int, expansion: float) -> None:
        super().__init__(width, blocks, heads, expansion)
        self.mlp = ViewMLP(width, blocks, expansion)
        self.score = nn.Linear(width, 1)
        self.norm = nn.LayerNorm(width)

    def selection_logits(self, tokens: Tensor) -> Tensor:
        """Predicted logits [..., K, 1] of views [..., K, D]."""
        return self.score(self.mlp(tokens))

    def forward(self, tokens: Tensor, slots: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `tf_lab.network.fusion`."""
        features = self.mlp(tokens)
        weights = weights_from_logits(self.score(features), slots)
        return self.norm(weighted_sum(features, weights)), weights
