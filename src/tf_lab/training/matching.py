"""Dense contrastive matching: corresponding pixels get like features (InfoNCE, 2018)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from tf_lab.geometry import sample_maps

APART = 1.5  # candidates nearer to the truth than this many strides are not wrong enough


def matching_loss(
    maps: Tensor, uv_a: Tensor, uv_b: Tensor, size: tuple[int, int], temperature: float
) -> tuple[Tensor, Tensor]:
    """Find each point of the first image among all points and epipolar candidates of the second.

    Args:
        maps: [B, 2, C, h, w] feature maps of image pairs.
        uv_a: [B, P, 2] pixels in the first images.
        uv_b: [B, P, 1 + E, 2] pixels in the second: the true one, then wrong ones.
        size: (width, height) of the images, pixels.
        temperature: of the softmax over cosine similarities.

    Returns:
        The loss, and the share of points whose most similar candidate is the true one.
    """
    B, P, n = uv_b.shape[:3]
    stride = size[0] / maps.shape[-1]
    a = F.normalize(sample_maps(maps[:, 0], uv_a, size), dim=-1)
    b = F.normalize(sample_maps(maps[:, 1], uv_b.flatten(1, 2), size), dim=-1).unflatten(1, (P, n))
    others = torch.einsum("bpc,bqc->bpq", a, b[:, :, 0])
    along = torch.einsum("bpc,bpec->bpe", a, b[:, :, 1:])
    true = uv_b[:, :, 0]
    close = torch.cdist(true, true) < APART * stride
    close &= ~torch.eye(P, dtype=torch.bool, device=close.device)
    close_along = (uv_b[:, :, 1:] - true[:, :, None]).norm(dim=-1) < APART * stride
    outside = ((uv_b[:, :, 1:] < -0.5) | (uv_b[:, :, 1:] > uv_b.new_tensor(size) - 0.5)).any(-1)
    logits = torch.cat(
        [
            others.masked_fill(close, -torch.inf),
            along.masked_fill(close_along | outside, -torch.inf),
        ],
        dim=-1,
    )
    target = torch.arange(P, device=maps.device).expand(B, P)
    loss = F.cross_entropy((logits / temperature).flatten(0, 1), target.flatten())
    return loss, (logits.argmax(-1) == target).float().mean()
