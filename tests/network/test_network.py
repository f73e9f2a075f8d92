"""The network's forward pass on a toy of known geometry."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from helpers.toy_views import COARSE, FINE, toy
from tf_lab.errors import TFLabError
from tf_lab.geometry import VoxelGrid
from tf_lab.network.chunks import Predictions, Views
from tf_lab.network.fusion import FUSIONS
from tf_lab.network.network import LEVELS, subgrid
from tf_lab.network.settings import NetworkConfig
from tf_lab.online.views import make_policy
from tf_lab.online.views.batch import BatchSelection
from tf_lab.training.losses import losses

Factory = Callable[..., Any]  # a Network; to mypy its parts are Tensor | Module

SIZE = (32, 24)
STRATEGIES = [part.name for part in FUSIONS]


def changed(views: Views, change: Callable[[Tensor], Tensor]) -> Views:
    return Views(change(views.images), change(views.K), change(views.world_T_cam))


def sees(points: Tensor, K: Tensor, world_T_cam: Tensor, far: float = 5.0) -> Tensor:
    """Whether a camera sees points [P, 3], written out: bool [P]."""
    camera = (torch.linalg.inv(world_T_cam) @ torch.cat([points, torch.ones(len(points), 1)], 1).T)[
        :3
    ]
    u, v = (K @ camera)[:2] / camera[2]
    on_image = (u > -0.5) & (u < SIZE[0] - 0.5) & (v > -0.5) & (v < SIZE[1] - 0.5)
    return on_image & (camera[2] >= 0.3) & (camera[2] <= far)


def seen_by_any(points: Tensor, inputs: dict[str, Any], b: int) -> Tensor:
    cameras = zip(inputs["views"].K[b], inputs["views"].world_T_cam[b], strict=True)
    return torch.stack([sees(points.reshape(-1, 3), k, pose) for k, pose in cameras]).any(0)


def assert_same(a: Predictions, b: Predictions, at: slice | int = slice(None)) -> None:
    for name, value in vars(a).items():
        other = vars(b)[name][at]
        torch.testing.assert_close(value, other, atol=1e-4, rtol=1e-4, msg=name)


@pytest.mark.parametrize("fusion", STRATEGIES)
def test_shapes(tiny_network: Factory, fusion: str) -> None:
    p = tiny_network(fusion=fusion)(**toy())
    assert p.coarse.shape == p.coarse_seen.shape == (2, 7, 7, 7)
    assert p.fine.shape == p.fine_active.shape == (2, 15, 15, 15)
    assert p.occupancy.shape == p.seen.shape == (2, 40)
    for value in vars(p).values():
        assert torch.isfinite(value).all()


def test_what_no_view_sees_is_told(tiny_network: Factory) -> None:
    inputs = toy(views=2)
    p = tiny_network(filter=False)(**inputs)
    for b in range(2):
        coarse = seen_by_any(COARSE.centers(), inputs, b).view(7, 7, 7)
        fine = seen_by_any(FINE.centers(), inputs, b).view(15, 15, 15)
        assert 0.1 < coarse.float().mean() < 0.9  # the toy has both
        assert torch.equal(p.coarse_seen[b], coarse)
        assert torch.equal(p.seen[b], seen_by_any(inputs["points"][b], inputs, b))
        within_coarse = coarse[1:6, 1:6, 1:6]
        for axis in range(3):
            within_coarse = within_coarse.repeat_interleave(3, dim=axis)
        assert torch.equal(p.fine_active[b], fine & within_coarse)


def test_the_depth_range_limits_what_is_seen(tiny_network: Factory) -> None:
    inputs = toy(batch=1, views=2)
    p = tiny_network(far=1.4)(**inputs)
    cameras = zip(inputs["views"].K[0], inputs["views"].world_T_cam[0], strict=True)
    expected = torch.stack([sees(inputs["points"][0], k, pose, far=1.4) for k, pose in cameras])
    assert torch.equal(p.seen[0], expected.any(0))


@pytest.mark.parametrize("bias", [-50.0, 50.0, 0.0])
def test_fine_level_is_where_truth_or_prediction_says_so(
    tiny_network: Factory, bias: float
) -> None:
    network, inputs = tiny_network(), toy()
    head = network.refinement.coarse_mask[-1]
    with torch.no_grad():
        head.bias.add_(bias)  # nothing predicted, everything, something
    p = network(**inputs)
    for b in range(2):
        near = (inputs["coarse_target"][b] | (p.coarse[b] > 0)) & p.coarse_seen[b]
        fine = seen_by_any(FINE.centers(), inputs, b).view(15, 15, 15)
        for i, j, k in torch.cartesian_prod(*[torch.arange(15)] * 3)[::37].tolist():
            expected = near[1 + i // 3, 1 + j // 3, 1 + k // 3] & fine[i, j, k]
            assert p.fine_active[b, i, j, k] == expected
    without_truth = network(**{**inputs, "coarse_target": None})
    if bias == -50:
        assert not without_truth.fine_active.any()
        assert torch.isfinite(without_truth.occupancy).all()
    if bias == 50:
        assert torch.equal(without_truth.fine_active, p.fine_active)


@pytest.mark.parametrize("fusion", STRATEGIES)
@pytest.mark.parametrize("refine", [True, False])
@pytest.mark.parametrize("masks", [True, False])
def test_gradient_reaches_every_parameter(
    tiny_network: Factory, fusion: str, refine: bool, masks: bool
) -> None:
    network = tiny_network(fusion=fusion, refine=refine, filter=masks).train()
    inputs = toy()
    fine_target = torch.rand(2, 15, 15, 15, generator=torch.Generator().manual_seed(1)) < 0.3
    sdf = torch.randn(2, 40, generator=torch.Generator().manual_seed(2))
    predictions = network(**inputs)
    losses(predictions, inputs["coarse_target"], fine_target, sdf, masks, 0.0)["loss"].backward()
    idle = ("refinement.coarse_mask", "refinement.fine_mask")  # without filter nobody asks them
    for name, parameter in network.named_parameters():
        if name.startswith(idle) and not masks:
            assert parameter.grad is None, name
            continue
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        # a softmax doesn't feel what is added to all logits
        if not name.endswith(("key.bias", "score.bias")):
            assert parameter.grad.abs().max() > 0, name


def test_gradients_in_half_precision_are_those_of_single(
    tiny_network: Factory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a voxel's channels are alike, dividing by their deviation overflows float16."""
    network, inputs = tiny_network(), toy()
    fine_target = torch.rand(2, 15, 15, 15, generator=torch.Generator().manual_seed(1)) < 0.3
    sdf = torch.randn(2, 40, generator=torch.Generator().manual_seed(2))
    found = []
    for enabled in (False, True):
        network.zero_grad()
        with torch.autocast("cpu", torch.float16, enabled=enabled):
            predictions = network(**inputs)
            terms = losses(predictions, inputs["coarse_target"], fine_target, sdf, True, 0.0)
        (1024 * terms["loss"]).backward()  # as a scaler does
        found.append(torch.cat([p.grad.flatten() for p in network.parameters()]))
    exact, half = found
    assert torch.isfinite(half).all()
    assert F.cosine_similarity(exact, half, dim=0) > 0.99


def test_without_refinement_no_convolution_spans_voxels(tiny_network: Factory) -> None:
    def kernels(network: Any) -> set[tuple[int, ...]]:
        return {m.kernel_size for m in network.modules() if isinstance(m, nn.Conv3d)}

    assert kernels(tiny_network(refine=False)) == {(1, 1, 1)}
    assert (3, 3, 3) in kernels(tiny_network())


@pytest.mark.parametrize("fusion", STRATEGIES)
def test_chunks_of_a_batch_do_not_mix(tiny_network: Factory, fusion: str) -> None:
    network, inputs = tiny_network(fusion=fusion), toy()
    both = network(**inputs)
    for b in range(2):
        one = {k: v[b : b + 1] if isinstance(v, Tensor) else v for k, v in inputs.items()}
        one["views"] = changed(inputs["views"], lambda x, b=b: x[b : b + 1])
        assert_same(network(**one), both, slice(b, b + 1))


def test_the_order_of_views_does_not_matter(tiny_network: Factory) -> None:
    network, inputs = tiny_network(), toy()
    permuted = changed(inputs["views"], lambda x: x[:, [2, 0, 1]])
    assert_same(network(**{**inputs, "views": permuted}), network(**inputs))


@pytest.mark.parametrize("keep", [None, 2])
def test_a_strategy_that_reads_in_order_reads_by_time(
    tiny_network: Factory, keep: int | None
) -> None:
    """However the views of a chunk lie in memory, and whichever of them a voxel keeps."""
    network, inputs = tiny_network(fusion="gru"), toy(views=4)
    select = None if keep is None else BatchSelection(make_policy("random", 0), keep)
    times = torch.tensor([[3, 0, 2, 1], [0, 1, 2, 3]])
    some = network(**{**inputs, "views": replace(inputs["views"], times=times), "keep": select})
    other = network(**{**inputs, "keep": select})
    assert (some.coarse - other.coarse)[0].abs().max() > 1e-4
    assert torch.equal(some.coarse[1], other.coarse[1])  # they are in order
    if keep is None:
        order = times.argsort(1)
        views = changed(inputs["views"], lambda x: torch.stack([x[b, order[b]] for b in range(2)]))
        assert_same(network(**{**inputs, "views": views}), some)


def test_occupancy_asks_the_features_around_a_point(tiny_network: Factory) -> None:
    """At a voxel's centre the decoder reads that voxel; half-way between two, their mean."""
    network = tiny_network()
    torch.manual_seed(4)
    coarse, fine = torch.randn(12, 7, 7, 7), torch.randn(12, 15, 15, 15)
    points = torch.tensor([[0.45, 0.75, 1.05], [0.50, 0.75, 1.05]])
    found = network.decode(coarse, COARSE, fine, FINE, points)
    # (0.45, 0.75, 1.05) is the centre of the coarse voxel (2, 3, 4) and the fine one (4, 7, 10)
    at_center = network.occupancy(coarse[:, 2, 3, 4], fine[:, 4, 7, 10])
    between = network.occupancy(
        coarse[:, 2, 3, 4] * 5 / 6 + coarse[:, 3, 3, 4] / 6,
        (fine[:, 4, 7, 10] + fine[:, 5, 7, 10]) / 2,
    )
    torch.testing.assert_close(found, torch.stack([at_center, between]), atol=1e-5, rtol=1e-5)


def test_levels_have_their_own_maps_tokens_and_fusion(tiny_network: Factory) -> None:
    network = tiny_network()
    maps = network.encode(toy(batch=1)["views"].images[0])
    assert set(maps) == set(LEVELS)
    assert maps["coarse"].shape == (3, 8, 3, 4)
    assert maps["fine"].shape == (3, 6, 12, 16)
    assert network.tokens["coarse"].linear.in_features == 8 + 5
    assert network.tokens["fine"].linear.in_features == 6 + 5
    assert network.fusion["coarse"] is not network.fusion["fine"]


@pytest.mark.parametrize(
    ("start", "shape", "expected"),
    [
        ((0.0, 0.0, 0.0), (15, 15, 15), ((1, 6), (1, 6), (1, 6))),
        ((-0.3, 0.3, 0.9), (3, 6, 9), ((0, 1), (2, 4), (4, 7))),
    ],
)
def test_the_coarse_voxels_of_a_fine_grid(
    start: tuple[float, float, float],
    shape: tuple[int, int, int],
    expected: tuple[tuple[int, int], ...],
) -> None:
    slices = subgrid(COARSE, VoxelGrid(start, 0.1, shape))
    assert tuple((s.start, s.stop) for s in slices) == expected


def test_configurations_that_make_no_sense() -> None:
    sizes: dict[str, Any] = dict(blocks=1, expansion=2.0, hidden=8, refine_blocks=1)
    with pytest.raises(TFLabError, match=r"fusion\.strategy=magic"):
        NetworkConfig(width=8, heads=2, fusion="magic", **sizes)
    with pytest.raises(TFLabError, match="multiple of heads=3"):
        NetworkConfig(width=8, heads=3, **sizes)
