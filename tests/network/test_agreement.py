"""Evidence that views agree: against loops over pairs, and what must not change it."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from helpers.toy_views import toy
from tf_lab.network.agreement import FEW, Agreement
from tf_lab.network.tokens import Measurements
from tf_lab.online.views.batch import BatchSelection
from tf_lab.online.views.selection import RandomSelection
from tf_lab.training.losses import losses

C, D, V = 16, 10, 6


def views(points: int = 30, seed: int = 0) -> Measurements:
    """Of points [P] in V views: valid at random, none at the first point, one at the second."""
    generator = torch.Generator().manual_seed(seed)
    valid = torch.rand(points, V, generator=generator) < 0.6
    valid[0], valid[1], valid[2] = False, torch.arange(V) == 3, True
    ray = torch.nn.functional.normalize(torch.randn(points, V, 3, generator=generator), dim=-1)
    phi = torch.randn(points, V, C, generator=generator) + 0.5
    depth = torch.rand(points, V, generator=generator)
    return Measurements(phi, depth, valid, ray, torch.zeros(points, V, 0))


def agreement(seed: int = 1) -> Agreement:
    """With random weights instead of zeros."""
    torch.manual_seed(seed)
    module = Agreement(C, D)
    torch.nn.init.normal_(module.linear.weight)
    return module


def by_loops(phi: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """The evidence of valid views [K, C], [K, 3] by its definition, view by view."""
    unit = phi / np.linalg.norm(phi, axis=1, keepdims=True)
    rows = []
    for i in range(len(unit)):
        others = [j for j in range(len(unit)) if j != i]
        cosines = [float(unit[i] @ unit[j]) for j in others]
        apart = [1 - float(ray[i] @ ray[j]) for j in others]
        groups = [np.mean([8 * unit[i, g] @ unit[j, g] for j in others]) for g in parts(C, 8)]
        variance = C * unit.var(axis=0, ddof=1)
        near = np.exp(-20 * np.array(apart))
        numbers = [max(cosines), np.mean(cosines), np.average(cosines, weights=near)]
        numbers += [np.average(cosines, weights=apart), len(others) / (len(others) + FEW)]
        rows.append([*numbers, *groups, *variance])
    return np.array(rows)


def parts(n: int, count: int) -> list[slice]:
    return [slice(i, i + n // count) for i in range(0, n, n // count)]


def test_evidence_is_that_of_all_pairs_of_valid_views() -> None:
    seen = views()
    found = agreement().evidence(seen)
    checked = 0
    for p in range(len(found)):
        valid = seen.valid[p]
        if valid.sum() > 1:
            expected = by_loops(seen.phi[p][valid].numpy(), seen.ray[p][valid].numpy())
            np.testing.assert_allclose(found[p][valid], expected, atol=1e-5)
            checked += 1
    assert checked > 20


def test_a_view_without_others_gives_zeros() -> None:
    seen, module = views(), agreement()
    for told in (module.evidence(seen), module(seen)):
        assert (told[:2] == 0).all()  # no view, one view
        assert (told[~seen.valid] == 0).all()
        assert told[2].abs().amax(-1).min() > 0


def test_an_untrained_map_adds_nothing() -> None:
    assert (Agreement(C, D)(views()) == 0).all()


def test_what_lies_in_invalid_slots_never_counts() -> None:
    seen, module = views(), agreement()
    gone = ~seen.valid
    rubbish = Measurements(
        seen.phi.masked_fill(gone[..., None], 1e4),
        seen.depth,
        seen.valid,
        seen.ray.masked_fill(gone[..., None], 0.57),
        seen.stereo,
    )
    torch.testing.assert_close(module(rubbish), module(seen))
    # nor do more empty slots
    more = Measurements(*(torch.cat([part, torch.zeros_like(part)], 1) for part in seen))
    told = module(more)
    torch.testing.assert_close(told[:, :V], module(seen), atol=1e-5, rtol=1e-5)
    assert (told[:, V:] == 0).all()


def test_the_order_of_views_is_the_order_of_what_is_added() -> None:
    seen, module = views(), agreement()
    for order in itertools.islice(itertools.permutations(range(V)), 3, 720, 97):
        permuted = Measurements(*(part[:, list(order)] for part in seen))
        expected = module(seen)[:, list(order)]
        torch.testing.assert_close(module(permuted), expected, atol=1e-5, rtol=1e-5)


def test_any_leading_shape() -> None:
    seen, module = views(30), agreement()
    shaped = Measurements(*(part.unflatten(0, (2, 3, 5)) for part in seen))
    torch.testing.assert_close(module(shaped).flatten(0, 2), module(seen))


def test_bfloat16_features_are_compared_in_float32() -> None:
    seen, module = views(), agreement()
    with torch.autocast("cpu", torch.bfloat16):
        evidence = module.evidence(seen._replace(phi=seen.phi.bfloat16()))
        told = module(seen)
    assert evidence.dtype == torch.float32
    torch.testing.assert_close(evidence, module.evidence(seen), atol=0.1, rtol=0.03)
    assert torch.isfinite(told).all()


@pytest.mark.parametrize("keep", [None, 2])
@pytest.mark.parametrize("fusion", ["transformer", "avg", "pred"])
def test_an_untrained_network_equals_the_plain_one(
    tiny_network: Callable[..., Any], keep: int | None, fusion: str
) -> None:
    select = None if keep is None else BatchSelection(RandomSelection(), keep)
    inputs = {**toy(), "keep": select}
    plain = tiny_network(fusion=fusion)(**inputs)
    found = tiny_network(fusion=fusion, matching=True)(**inputs)
    for name, value in vars(plain).items():
        assert torch.equal(vars(found)[name], value), name


def test_gradient_reaches_it_and_is_finite(tiny_network: Callable[..., Any]) -> None:
    """Also where a voxel has no view, or one."""
    network = tiny_network(matching=True).train()
    for module in network.agreement.values():
        torch.nn.init.normal_(module.linear.weight, std=0.1)
    inputs = toy()
    fine: Tensor = torch.rand(2, 15, 15, 15, generator=torch.Generator().manual_seed(1)) < 0.3
    sdf = torch.randn(2, 40, generator=torch.Generator().manual_seed(2))
    losses(network(**inputs), inputs["coarse_target"], fine, sdf, True, 0.0)["loss"].backward()
    for name, parameter in network.named_parameters():
        assert torch.isfinite(parameter.grad).all(), name
    for module in network.agreement.values():
        assert (module.linear.weight.grad.abs().amax(0) > 0).all()  # every number is read


def test_selection_does_not_look_at_other_views(tiny_network: Callable[..., Any]) -> None:
    """A view's logits are those of the plain token, whatever the others are."""
    network = tiny_network(matching=True)
    for module in network.agreement.values():
        torch.nn.init.normal_(module.linear.weight)
    channels = network.config.encoder["fine_channels"]
    seen = views()
    seen = seen._replace(phi=seen.phi[..., :channels])
    logits = network.selection_logits("fine", network.embed("fine", seen))
    alone = Measurements(*(part[:, :1] for part in seen))
    expected = network.selection_logits("fine", network.embed("fine", alone))
    torch.testing.assert_close(logits[:, :1], expected)
    assert not torch.equal(network.embed_kept("fine", seen)[2], network.embed("fine", seen)[2])
