"""Training keeps of each voxel's views what the view store would keep at test time."""

from collections.abc import Callable

import torch

from tf_lab.network.network import Network


def example(network: Network) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    tokens = torch.randn(40, 9, network.config.width, generator=generator)
    valid = torch.rand(40, 9, generator=generator) < 0.6
    valid[0], valid[1] = False, True
    return tokens, valid


def test_nothing_is_dropped_without_keep(tiny_network: Callable[..., Network]) -> None:
    network = tiny_network()
    tokens, valid = example(network)
    kept, slots = network.keep_views("fine", tokens, valid, None, False)
    assert kept is tokens and slots is None


def test_first_valid_views_are_kept(tiny_network: Callable[..., Network]) -> None:
    network = tiny_network()
    tokens, valid = example(network)
    kept, slots = network.keep_views("fine", tokens, valid, 4, False)
    assert slots is not None and kept.shape == (40, 4, network.config.width)
    for p in range(40):
        expected = [v for v in range(9) if valid[p, v]][:4]
        assert int(slots[p].sum()) == len(expected)
        assert torch.equal(kept[p][slots[p]], tokens[p, expected])


def test_ranked_views_are_those_of_the_highest_logit(tiny_network: Callable[..., Network]) -> None:
    network = tiny_network(heads=1)  # with one head the order of weights is that of the logits
    tokens, valid = example(network)
    kept, slots = network.keep_views("coarse", tokens, valid, 3, True)
    logits = network.selection_logits("coarse", tokens)
    assert slots is not None and logits is not None
    for p in range(40):
        views = [v for v in range(9) if valid[p, v]]
        expected = sorted(views, key=lambda v: -logits[p, v, 0].item())[:3]
        assert torch.equal(kept[p][slots[p]], tokens[p, expected])


def test_a_fusion_without_preference_keeps_the_first(
    tiny_network: Callable[..., Network],
) -> None:
    network = tiny_network(fusion="avg")
    tokens, valid = example(network)
    ranked, _ = network.keep_views("fine", tokens, valid, 4, True)
    first, _ = network.keep_views("fine", tokens, valid, 4, False)
    assert torch.equal(ranked, first)
