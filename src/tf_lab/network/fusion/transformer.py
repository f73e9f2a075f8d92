"""Fusion by a transformer: a learned token reads the views (paper, Sec. 3.1; after ViT)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from tf_lab.network.fusion.strategy import Fusion
from tf_lab.network.fusion.weights import weights_from_logits


def attend(query: Tensor, key: Tensor, value: Tensor, mask: Tensor | None) -> Tensor:
    """softmax(q k^T / sqrt(d)) v over few tokens: [..., H, Q, d] of q, [..., H, T, d] of k and v.

    ``mask`` [..., 1, 1, T] says which tokens may be read; None: all. On a GPU by matrix products:
    torch's fused kernels pad some ten views to blocks of 64, which was 45 % of a training step's
    GPU time.
    """
    if not query.is_cuda:
        return F.scaled_dot_product_attention(query, key, value, attn_mask=mask)
    return _attend_by_products(query, key, value, mask)


def _attend_by_products(query: Tensor, key: Tensor, value: Tensor, mask: Tensor | None) -> Tensor:
    scores = (query * query.shape[-1] ** -0.5) @ key.transpose(-2, -1)
    if mask is not None:
        scores = scores.masked_fill(~mask, float("-inf"))
    return scores.softmax(-1).to(value.dtype) @ value


class Block(nn.Module):
    """Multi-head self-attention and a ReLU feed-forward layer, pre-norm, both residual."""

    def __init__(self, width: int, heads: int, expansion: float) -> None:
        super().__init__()
        self.heads = heads
        self.attention_norm = nn.LayerNorm(width)
        self.query = nn.Linear(width, width)
        self.key = nn.Linear(width, width)
        self.value = nn.Linear(width, width)
        self.project = nn.Linear(width, width)
        hidden = round(width * expansion)
        self.feed_forward = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, width)
        )

    def split(self, x: Tensor) -> Tensor:
        """[..., T, D] -> [..., H, T, D / H]."""
        return x.unflatten(-1, (self.heads, -1)).transpose(-2, -3)

    def forward(self, x: Tensor, mask: Tensor | None, outputs: int | None = None) -> Tensor:
        """Attend and transform.

        Args:
            x: [..., T, D].
            mask: bool [..., 1, 1, T], which tokens may be read; None: all.
            outputs: compute only the first ``outputs`` tokens (all are still read).
        """
        normed = self.attention_norm(x)
        wanted = x if outputs is None else x[..., :outputs, :]
        query = self.query(normed if outputs is None else normed[..., :outputs, :])
        read = attend(
            self.split(query), self.split(self.key(normed)), self.split(self.value(normed)), mask
        )
        wanted = wanted + self.project(read.transpose(-2, -3).flatten(-2))
        return wanted + self.feed_forward(wanted)

    def logits(self, token: Tensor, views: Tensor) -> Tensor:
        """Attention logits of one query token [D] over views [..., K, D]: [..., K, H]."""
        query = self.query(self.attention_norm(token)).unflatten(-1, (self.heads, -1))
        query = query * query.shape[-1] ** -0.5
        # q . (W x + b) = (W^T q) . x + q . b: one column a head instead of all keys
        weight, bias = (p.unflatten(0, (self.heads, -1)) for p in (self.key.weight, self.key.bias))
        columns = torch.einsum("hd,hdc->hc", query, weight)
        constant = torch.einsum("hd,hd->h", query, bias)
        return F.linear(self.attention_norm(views), columns, constant)


class TransformerFusion(Fusion):
    """A learned fusion token attends to the views; psi is its output.

    The weights are the fusion token's first-block attention over the views, averaged over heads.
    Its query is the same at every point, so a view's logits depend on that view alone.

    Args:
        width: D.
        blocks: 8 in the paper.
        heads: 4 in the paper.
        expansion: hidden width of the feed-forward layers over D.
    """

    ranks_views = True

    def __init__(self, width: int, blocks: int, heads: int, expansion: float) -> None:
        super().__init__(width, blocks, heads, expansion)
        self.token = nn.Parameter(torch.randn(width) * 0.02)
        self.blocks = nn.ModuleList(Block(width, heads, expansion) for _ in range(blocks))
        self.norm = nn.LayerNorm(width)

    def selection_logits(self, tokens: Tensor) -> Tensor:
        """First-block logits [..., K, H] of views [..., K, D]."""
        first = self.blocks[0]
        assert isinstance(first, Block)
        return first.logits(self.token, tokens)

    def forward(self, tokens: Tensor, slots: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `tf_lab.network.fusion`."""
        weights = weights_from_logits(self.selection_logits(tokens), slots)
        token = self.token.to(tokens.dtype).expand(*tokens.shape[:-2], 1, -1)
        x = torch.cat([token, tokens], dim=-2)
        mask = None
        if slots is not None:  # the fusion token itself may always be read
            readable = F.pad(slots, (1, 0), value=True)
            mask = readable[..., None, None, :]
        for block in self.blocks[:-1]:
            x = block(x, mask)
        x = self.blocks[-1](x, mask, outputs=1)  # the views' last outputs are never read
        return self.norm(x[..., 0, :]), weights
