"""Training keeps of each voxel's views what the view store would keep at test time."""

from collections.abc import Callable

import torch

from tf_lab.network.network import Network
from tf_lab.network.tokens import Measurements


def example(network: Network, level: str) -> Measurements:
    generator = torch.Generator().manual_seed(0)
    channels = network.tokens[level].linear.in_features - 5
    phi = torch.randn(40, 9, channels, generator=generator)
    depth = torch.rand(40, 9, generator=generator) * 4
    valid = torch.rand(40, 9, generator=generator) < 0.6
    valid[0], valid[1] = False, True
    ray = torch.nn.functional.normalize(torch.randn(40, 9, 3, generator=generator), dim=-1)
    return Measurements(phi, depth, valid, ray)


def assert_kept(
    kept: Measurements, slots: torch.Tensor, measured: Measurements, point: int, views: list[int]
) -> None:
    assert torch.equal(kept.valid, slots)
    for some, every in zip(kept, measured, strict=True):
        assert torch.equal(some[point][slots[point]], every[point, views])


def test_nothing_is_dropped_without_keep(tiny_network: Callable[..., Network]) -> None:
    network = tiny_network()
    measured = example(network, "fine")
    kept, slots = network.keep_views("fine", measured, None, False)
    assert kept is measured and slots is None


def test_first_valid_views_are_kept(tiny_network: Callable[..., Network]) -> None:
    network = tiny_network()
    measured = example(network, "fine")
    kept, slots = network.keep_views("fine", measured, 4, False)
    assert slots is not None and kept.ray.shape == (40, 4, 3)
    for p in range(40):
        expected = [v for v in range(9) if measured.valid[p, v]][:4]
        assert_kept(kept, slots, measured, p, expected)


def test_ranked_views_are_those_of_the_highest_logit(tiny_network: Callable[..., Network]) -> None:
    network = tiny_network(heads=1)  # with one head the order of weights is that of the logits
    measured = example(network, "coarse")
    kept, slots = network.keep_views("coarse", measured, 3, True)
    logits = network.selection_logits("coarse", network.tokens["coarse"](*measured))
    assert slots is not None and logits is not None
    for p in range(40):
        views = [v for v in range(9) if measured.valid[p, v]]
        expected = sorted(views, key=lambda v: -logits[p, v, 0].item())[:3]
        assert_kept(kept, slots, measured, p, expected)


def test_a_fusion_without_preference_keeps_the_first(
    tiny_network: Callable[..., Network],
) -> None:
    network = tiny_network(fusion="avg")
    measured = example(network, "fine")
    ranked, _ = network.keep_views("fine", measured, 4, True)
    first, _ = network.keep_views("fine", measured, 4, False)
    assert torch.equal(ranked.phi, first.phi)
