"""The contrastive loss on toys whose value is known by hand."""

import math

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tf_lab.network.encoders.resnet import ResNet
from tf_lab.training.pretrain_encoder import APART, Matching, matching_loss

SIZE = (8, 6)  # width, height of the images


def grid_points(step: int = 2) -> Tensor:
    """Pixels [P, 2], `step` apart."""
    v, u = torch.meshgrid(torch.arange(0, 6, step), torch.arange(0, 8, step), indexing="ij")
    return torch.stack([u, v], -1).reshape(-1, 2).float()


def distinct_maps() -> Tensor:
    """[1, 2, 48, 6, 8]: every pixel has a feature of its own, the same in both images."""
    return torch.eye(48).T.reshape(1, 1, 48, 6, 8).expand(1, 2, 48, 6, 8)


def with_wrong(true: Tensor, wrong: Tensor) -> Tensor:
    """uv_b [1, P, 2, 2]: the true pixels [P, 2] and one wrong pixel each [P, 2]."""
    return torch.stack([true, wrong], dim=1)[None]


def far_from(uv: Tensor) -> Tensor:
    """Pixels on the image more than `APART` away from each of [P, 2]."""
    return torch.stack([(uv[:, 0] + 4) % 8, (uv[:, 1] + 3) % 6], -1)


def test_perfect_features_are_found() -> None:
    uv = grid_points()
    loss, top1 = matching_loss(
        distinct_maps(), uv[None], with_wrong(uv, far_from(uv)), SIZE, 1, temperature=0.07
    )
    # similarity 1 with the truth; 0 with the 11 other points and one's own wrong candidate
    assert len(uv) == 12
    assert float(loss) == pytest.approx(math.log1p(12 * math.exp(-1 / 0.07)), abs=1e-6)
    assert float(top1) == 1


def test_features_that_tell_nothing_cost_the_log_of_the_candidates() -> None:
    uv = grid_points()
    maps = torch.ones(1, 2, 5, 6, 8)
    loss, _ = matching_loss(maps, uv[None], with_wrong(uv, far_from(uv)), SIZE, 1, 0.07)
    # all others are at least 2 pixels away: all points, and one candidate of one's own
    assert float(loss) == pytest.approx(math.log(len(uv) + 1), rel=1e-5)


def test_random_features_cost_about_as_much_and_find_as_little() -> None:
    uv = torch.rand(64, 400, 2, generator=torch.Generator().manual_seed(0)) * 90 + 5
    maps = torch.randn(64, 2, 64, 50, 50, generator=torch.Generator().manual_seed(1))
    loss, top1 = matching_loss(maps, uv, uv[:, :, None], (100, 100), 2, temperature=1.0)
    assert float(loss) == pytest.approx(math.log(400), abs=0.05)
    assert float(top1) < 0.02


def test_by_hand() -> None:
    """Two points, one wrong candidate each, features in the plane at known angles."""
    angles = {"a": (0.0, 90.0), "b": (30.0, 70.0), "wrong": (60.0, 120.0)}
    maps = torch.zeros(1, 2, 2, 1, 12)

    def put(image: int, column: int, degrees: float) -> None:
        angle = math.radians(degrees)
        maps[0, image, :, 0, column] = 3.0 * torch.tensor([math.cos(angle), math.sin(angle)])

    columns = {"a": (0, 5), "b": (1, 6), "wrong": (4, 10)}
    for name, degrees in angles.items():
        for column, value in zip(columns[name], degrees, strict=True):
            put(0 if name == "a" else 1, column, value)
    pixels = {name: torch.tensor([[c, 0.0] for c in columns[name]]) for name in columns}
    loss, top1 = matching_loss(
        maps, pixels["a"][None], with_wrong(pixels["b"], pixels["wrong"]), (12, 1), 1, 0.5
    )

    def similarity(a: float, b: float) -> float:
        return math.exp(math.cos(math.radians(a - b)) / 0.5)

    terms = []
    for i in range(2):
        a = angles["a"][i]
        true = similarity(a, angles["b"][i])
        other = similarity(a, angles["b"][1 - i])
        wrong = similarity(a, angles["wrong"][i])
        terms.append(-math.log(true / (true + other + wrong)))
    assert float(loss) == pytest.approx(sum(terms) / 2, rel=1e-5)
    assert float(top1) == 1


@pytest.mark.parametrize("stride", [1, 2])
def test_candidates_beside_the_truth_are_not_wrong(stride: int) -> None:
    """Nearer than `APART` cells of the map, and outside the image: not counted."""
    maps = torch.ones(1, 2, 3, 48 // stride, 64 // stride)
    uv = torch.tensor([[20.0, 20.0], [40.0, 20.0], [20.0, 40.0]])
    limit = APART * stride

    def cost(wrong: list[list[float]]) -> float:
        loss, _ = matching_loss(
            maps, uv[None], with_wrong(uv, torch.tensor(wrong)), (64, 48), stride, 1.0
        )
        return float(loss)

    apart = [[x + limit + 0.1, y] for x, y in uv.tolist()]
    beside = [[x + limit - 0.1, y] for x, y in uv.tolist()]
    outside = [[-1.0, 5.0], [64.0, 5.0], [5.0, 48.0]]
    assert cost(apart) == pytest.approx(math.log(4), rel=1e-5)
    assert cost(beside) == pytest.approx(math.log(3), rel=1e-5)
    assert cost(outside) == pytest.approx(math.log(3), rel=1e-5)
    # neighbours among the true points: two of three within the limit leave two choices or three
    uv = torch.tensor([[20.0, 20.0], [20.0 + limit - 0.1, 20.0], [40.0, 40.0]])
    loss, _ = matching_loss(maps, uv[None], uv[None, :, None], (64, 48), stride, 1.0)
    assert float(loss) == pytest.approx((2 * math.log(2) + math.log(3)) / 3, rel=1e-5)


def test_the_gradient_pulls_corresponding_features_together() -> None:
    generator = torch.Generator().manual_seed(0)
    maps = torch.randn(1, 2, 16, 6, 8, generator=generator, requires_grad=True)
    uv = grid_points()
    optimizer = torch.optim.Adam([maps], lr=0.1)
    for _ in range(60):
        loss, _ = matching_loss(maps, uv[None], with_wrong(uv, far_from(uv)), SIZE, 1, 0.1)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    found = maps.detach()
    loss, top1 = matching_loss(found, uv[None], with_wrong(uv, far_from(uv)), SIZE, 1, 0.1)
    assert float(top1) == 1
    assert float(loss) < 0.01
    u, v = uv.long().unbind(-1)
    a, b = (F.normalize(found[0, i][:, v, u], dim=0) for i in range(2))
    assert float((a * b).sum(0).min()) > 0.7


@pytest.mark.parametrize("factor", [0.0, 0.1])
def test_a_trunk_that_stays_keeps_its_statistics(factor: float) -> None:
    """Those of its batch normalisation, too, which no gradient changes."""
    sizes = {"coarse_stride": 4, "fine_stride": 2, "coarse_channels": 8, "fine_channels": 8}
    maps = {**sizes, "unit_norm": True}
    encoder = ResNet(8, [1, 1], 2, False, "batch", **maps)
    matching = Matching(encoder, 1e-3, factor, 10, 0.1, [])
    before = {name: value.clone() for name, value in encoder.named_buffers()}
    assert any(name.endswith("running_mean") for name in before)
    encoder(torch.randint(0, 256, (2, 3, 32, 32), dtype=torch.uint8))
    same = [torch.equal(value, before[name]) for name, value in encoder.named_buffers()]
    assert all(same) == (factor == 0)
    assert matching.encoder is encoder
