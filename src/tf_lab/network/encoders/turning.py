"""Features turned to be like another encoder's: what learnt from those can learn on from these."""

from __future__ import annotations

from collections.abc import Iterable

import torch
import torch.nn.functional as F
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.network.encoders.pyramid import Encoder


@torch.no_grad()
def turn_like(encoder: Encoder, other: Encoder, images: Iterable[Tensor]) -> dict[str, float]:
    """Turn both maps' features by the rotation or reflection that makes them most like another's.

    Orthogonal Procrustes (Schönemann 1966), folded into the heads. Features keep their lengths and
    the angles between them, so that they match as they did.

    Args:
        encoder: whose heads are changed in place.
        other: of maps of the same strides and channels.
        images: batches of RGB in 0..255, [N, 3, H, W] each.

    Returns:
        By level, the mean cosine between features of the two at the same pixels, when turned.

    Raises:
        TFLabError: their maps differ in size.
    """
    encoder.eval()
    other.eval()
    products: dict[str, Tensor] = {}
    count: dict[str, int] = {}
    for batch in images:
        for name, own, theirs in zip(("coarse", "fine"), encoder(batch), other(batch), strict=True):
            if own.shape != theirs.shape:
                raise TFLabError(
                    f"the {name} maps of the two encoders have {tuple(own.shape[1:])} and "
                    f"{tuple(theirs.shape[1:])} channels, rows and columns; they need the same"
                )
            a, b = (F.normalize(x, dim=1).double() for x in (own, theirs))
            products[name] = products.get(name, 0) + torch.einsum("nchw,ndhw->cd", a, b)
            count[name] = count.get(name, 0) + a[:, 0].numel()
    similar = {}
    for name, product in products.items():
        left, stretched, right = torch.linalg.svd(product)
        turn = (left @ right).T.float()  # of a column of the encoder's to one of the other's
        head = encoder.coarse_head if name == "coarse" else encoder.fine_head
        head.weight.copy_(torch.einsum("oc,cikl->oikl", turn, head.weight))
        assert head.bias is not None
        head.bias.copy_(turn @ head.bias)
        similar[name] = float(stretched.sum()) / count[name]
    return similar
