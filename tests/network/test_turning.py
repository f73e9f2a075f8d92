"""Turning features: recovered where they were turned, angles as they were."""

from collections.abc import Iterator

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.network.encoders import make_encoder
from tf_lab.network.encoders.pyramid import Encoder
from tf_lab.network.encoders.turning import turn_like

SIZES = {
    "top_stride": 16,
    "coarse_stride": 8,
    "fine_stride": 2,
    "coarse_channels": 12,
    "fine_channels": 8,
    "unit_norm": True,
    "pyramid_channels": 8,
}


def made(seed: int, **others: int) -> Encoder:
    torch.manual_seed(seed)
    return make_encoder("efficientnet_lite0", **{**SIZES, **others}).eval()


def images(seed: int = 0) -> Iterator[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    for _ in range(3):
        yield torch.rand(2, 3, 32, 48, generator=generator) * 255


def features(encoder: Encoder) -> list[Tensor]:
    with torch.no_grad():
        maps = [encoder(batch) for batch in images(1)]
    return [
        torch.cat([level.permute(0, 2, 3, 1).flatten(0, 2) for level in m])
        for m in zip(*maps, strict=True)
    ]


def test_features_that_were_turned_are_turned_back() -> None:
    """By a random rotation (QR of noise) of each level."""
    encoder, other = made(0), made(0)
    torch.manual_seed(3)
    for head in (other.coarse_head, other.fine_head):
        turn = torch.linalg.qr(torch.randn(len(head.weight), len(head.weight)))[0]
        with torch.no_grad():
            head.weight.copy_(torch.einsum("ab,bikl->aikl", turn, head.weight))
            head.bias.copy_(turn @ head.bias)
    similar = turn_like(encoder, other, images())
    assert similar == pytest.approx({"coarse": 1, "fine": 1}, abs=1e-5)
    for a, b in zip(features(encoder), features(other), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-4)


def test_others_become_more_alike_and_match_as_before() -> None:
    encoder, other = made(0), made(1)
    before, theirs = features(encoder), features(other)
    similar = turn_like(encoder, other, images())
    for name, old, new, wanted in zip(
        ("coarse", "fine"), before, features(encoder), theirs, strict=True
    ):
        torch.testing.assert_close(new @ new.T, old @ old.T, rtol=0, atol=1e-3)
        alike = F.cosine_similarity(new, wanted).mean()
        assert alike > F.cosine_similarity(old, wanted).mean() + 0.05
        assert float(alike) == pytest.approx(similar[name], abs=0.05)  # of other images


def test_maps_of_other_sizes_are_told() -> None:
    with pytest.raises(TFLabError, match=r"fine maps of the two encoders have \(8, 16, 24\) and"):
        turn_like(made(0), made(1, fine_channels=4), images())
