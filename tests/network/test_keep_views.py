"""Training keeps of each voxel's views what the view store would keep at test time."""

from collections.abc import Callable

import pytest
import torch

from tf_lab.network.network import Network
from tf_lab.network.tokens import Measurements
from tf_lab.online.views import POLICIES, make_policy
from tf_lab.online.views.batch import BatchSelection


def example(network: Network, level: str) -> Measurements:
    generator = torch.Generator().manual_seed(0)
    channels = network.tokens[level].linear.in_features - 5
    phi = torch.randn(40, 9, channels, generator=generator)
    depth = torch.rand(40, 9, generator=generator) * 4
    valid = torch.rand(40, 9, generator=generator) < 0.6
    valid[0], valid[1] = False, True
    ray = torch.nn.functional.normalize(torch.randn(40, 9, 3, generator=generator), dim=-1)
    return Measurements(phi, depth, valid, ray, torch.zeros(40, 9, 0))


def assert_kept(
    kept: Measurements, slots: torch.Tensor, measured: Measurements, point: int, views: list[int]
) -> None:
    assert torch.equal(kept.valid, slots)
    for some, every in zip(kept, measured, strict=True):
        assert torch.equal(some[point][slots[point]], every[point, views])


CENTERS = torch.randn(40, 9, 3, generator=torch.Generator().manual_seed(1))
KEYS = torch.arange(len(CENTERS))[:, None].expand(-1, 3)


def keeping(name: str, views: int) -> BatchSelection:
    return BatchSelection(make_policy(name, 0), views)


def test_nothing_is_dropped_without_keep(tiny_network: Callable[..., Network]) -> None:
    network = tiny_network()
    measured = example(network, "fine")
    kept, slots, chosen = network.keep_views("fine", measured, CENTERS, KEYS, None)
    assert kept is measured and slots is None and chosen is None


@pytest.mark.parametrize("name", [policy.name for policy in POLICIES])
def test_the_chosen_views_measurements_are_kept(
    tiny_network: Callable[..., Network], name: str
) -> None:
    network = tiny_network()
    measured = example(network, "fine")
    kept, slots, _ = network.keep_views("fine", measured, CENTERS, KEYS, keeping(name, 4))
    assert slots is not None and kept.ray.shape == (40, 4, 3)
    logits = network.selection_logits("fine", network.embed("fine", measured))
    views, filled = keeping(name, 4)(logits, measured.valid, CENTERS, KEYS)
    assert torch.equal(filled, slots)
    for p in range(40):
        assert_kept(kept, slots, measured, p, views[p][filled[p]].tolist())


def test_attention_keeps_the_highest_logits_and_the_last(
    tiny_network: Callable[..., Network],
) -> None:
    """The paper's rule drops before it adds: the last view that sees the voxel always stays."""
    network = tiny_network(heads=1)  # with one head the order of weights is that of the logits
    measured = example(network, "coarse")
    kept, slots, _ = network.keep_views("coarse", measured, CENTERS, KEYS, keeping("attention", 3))
    logits = network.selection_logits("coarse", network.embed("coarse", measured))
    assert slots is not None and logits is not None
    for p in range(40):
        *views, last = [v for v in range(9) if measured.valid[p, v]] or [-1]
        best = sorted(views, key=lambda v: -logits[p, v, 0].item())[:2]
        expected = measured.ray[p, [*best, last]] if last >= 0 else torch.empty(0, 3)
        assert sorted(kept.ray[p][slots[p]].tolist()) == sorted(expected.tolist())


def test_a_fusion_without_preference_keeps_by_chance(
    tiny_network: Callable[..., Network],
) -> None:
    network = tiny_network(fusion="avg")
    measured = example(network, "fine")
    kept, slots, _ = network.keep_views("fine", measured, CENTERS, KEYS, keeping("attention", 4))
    by_chance, _, _ = network.keep_views("fine", measured, CENTERS, KEYS, keeping("random", 4))
    assert torch.equal(kept.phi[slots], by_chance.phi[slots])
