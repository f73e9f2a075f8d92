"""Images whose sides the strides do not divide: features are sampled at their place, too."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from tf_lab.network.chunks import Views
from tf_lab.network.network import LEVELS
from tf_lab.online.frames import Frames

WIDTH, HEIGHT = 37, 29
STRIDES = {"coarse": 8, "fine": 2}  # of the tiny network
K = torch.tensor([[30.0, 0, 18.0], [0, 30.0, 14.0], [0, 0, 1]])


def places(images: Tensor) -> dict[str, Tensor]:
    """Maps that say where in the image each of their pixels lies: its middle, u and v."""
    found = {}
    for level, stride in STRIDES.items():
        h, w = -(-HEIGHT // stride), -(-WIDTH // stride)
        v, u = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
        middle = torch.stack([u, v]) * stride + (stride - 1) / 2
        found[level] = middle.float().expand(len(images), 2, h, w)
    return found


def points_at(uv: Tensor) -> Tensor:
    """Points [P, 3] two metres in front of the camera at the origin, seen at pixels [P, 2]."""
    return torch.stack([(uv[:, 0] - 18) / 15, (uv[:, 1] - 14) / 15, torch.full((len(uv),), 2.0)], 1)


@pytest.mark.parametrize("level", LEVELS)
def test_features_lie_where_the_encoder_saw_them(
    tiny_network: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, level: str
) -> None:
    network = tiny_network()
    h, w = network.encode(torch.zeros(1, 3, HEIGHT, WIDTH))[level].shape[-2:]
    monkeypatch.setattr(network, "encode", places)
    assert (h, w) == places(torch.zeros(1, 3))[level].shape[-2:]
    # up to the last whole pixel of the coarse map on every side
    uv = torch.rand(200, 2, generator=torch.Generator().manual_seed(0))
    uv = 3.5 + uv * torch.tensor([32.0, 24.0])
    points, image = points_at(uv), torch.zeros(3, HEIGHT, WIDTH, dtype=torch.uint8)

    online = Frames(network, torch.float32)
    online.add(image, K, torch.eye(4))
    told = online.measure(level, points, torch.zeros(len(points), dtype=torch.int64))
    torch.testing.assert_close(told.phi, uv, atol=1e-3, rtol=0)

    views = Views(image.float()[None, None], K[None, None], torch.eye(4)[None, None])
    trained = network._measure(level, places(image[None])[level], views, points[None])
    torch.testing.assert_close(trained.phi[0, :, 0], uv, atol=1e-3, rtol=0)
