"""What `tf_lab.network.fusion` promises of a strategy, as checks.

Tests run every registered strategy through them. For one of your own::

    for check in CHECKS:
        check("mine")  # or its settings; an AssertionError says what it does not keep
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import torch
from torch import Tensor
from torch.testing import assert_close

from tf_lab.network.fusion import FUSIONS, make_fusion
from tf_lab.network.fusion.strategy import Fusion

D, K, HEADS, POINTS = 16, 6, 4, 12


def example(settings: Any) -> Fusion:
    """A small strategy in evaluation mode, its weights away from special values."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(3)
        strategy = make_fusion(settings, D, 3, HEADS, 2.0).eval()
        with torch.no_grad():
            for parameter in strategy.parameters():
                parameter.add_(0.3 * torch.randn_like(parameter))
    return strategy


def tokens_of(*shape: int, seed: int = 0) -> Tensor:
    """Random tokens [..., D]."""
    return torch.randn(*shape, D, generator=torch.Generator().manual_seed(seed))


def slots_of(points: int, seed: int = 0) -> Tensor:
    """Random slots [points, K], one of each or more filled."""
    slots = torch.rand(points, K, generator=torch.Generator().manual_seed(seed)) < 0.5
    slots[:, 0] |= ~slots.any(1)
    return slots


def weights_are_shares(settings: Any) -> None:
    """At least 0, 0 in empty slots, 1 in all."""
    for seed in range(5):
        slots = slots_of(POINTS, seed)
        fused, weights = example(settings)(tokens_of(POINTS, K, seed=seed), slots)
        assert fused.shape == (POINTS, D), f"features of {tuple(fused.shape)}"
        assert weights.shape == (POINTS, K), f"weights of {tuple(weights.shape)}"
        assert (weights >= 0).all() and (weights[~slots] == 0).all()
        assert_close(weights.sum(-1), torch.ones(POINTS))


def leading_shapes_are_any(settings: Any) -> None:
    """Voxels are fused each by itself, however many there are; without slots all are filled."""
    strategy, tokens = example(settings), tokens_of(2, 5, K)
    fused, weights = strategy(tokens)
    assert fused.shape == (2, 5, D) and weights.shape == (2, 5, K)
    masked = strategy(tokens, torch.ones(2, 5, K, dtype=torch.bool))
    assert_close(masked, (fused, weights), atol=1e-5, rtol=1e-5)
    none = strategy(tokens[:0], torch.ones(0, 5, K, dtype=torch.bool))
    assert none[0].shape == (0, 5, D) and none[1].shape == (0, 5, K)
    alone = torch.stack([strategy(t)[0] for t in tokens.flatten(0, 1)])
    assert_close(alone.view_as(fused), fused, atol=1e-5, rtol=1e-5)


def empty_slots_say_nothing(settings: Any) -> None:
    """Whatever they hold; a voxel with them is one without them."""
    strategy, tokens, slots = example(settings), tokens_of(POINTS, K), slots_of(POINTS)
    fused, weights = strategy(tokens, slots)
    other = torch.where(slots[..., None], tokens, 100 * tokens_of(POINTS, K, seed=9))
    assert_close(strategy(other, slots), (fused, weights), atol=1e-6, rtol=1e-6)
    for point in range(POINTS):
        alone, alone_weights = strategy(tokens[point][slots[point]])
        assert_close(alone, fused[point], atol=1e-5, rtol=1e-5)
        assert_close(alone_weights, weights[point][slots[point]])


def order_matters_if_it_says_so(settings: Any) -> None:
    """``ordered`` is what it does."""
    strategy, tokens, slots = example(settings), tokens_of(POINTS, K), slots_of(POINTS)
    fused, weights = strategy(tokens, slots)
    for seed in range(5):
        order = torch.randperm(K, generator=torch.Generator().manual_seed(seed))
        again, permuted = strategy(tokens[:, order], slots[:, order])
        if strategy.ordered:
            assert (again - fused).abs().max() > 1e-4, "the order has no influence"
        else:
            assert_close(again, fused, atol=1e-5, rtol=1e-5)
            assert_close(permuted, weights[:, order], atol=1e-5, rtol=1e-5)


def voxels_without_views_stay_finite(settings: Any) -> None:
    """In training, too: they give finite gradients, and none to what empty slots hold."""
    strategy, slots = example(settings), slots_of(4)
    slots[2] = False
    tokens = tokens_of(4, K).requires_grad_()
    fused, weights = strategy(tokens, slots)
    assert torch.isfinite(fused).all() and (weights[2] == 0).all()
    (fused.square().sum() + weights.square().sum()).backward()
    assert tokens.grad is not None
    assert torch.isfinite(tokens.grad).all() and (tokens.grad[~slots] == 0).all()
    for name, parameter in strategy.named_parameters():
        assert parameter.grad is not None, f"{name} has no gradient"
        assert torch.isfinite(parameter.grad).all(), name


def a_view_is_ranked_by_itself(settings: Any) -> None:
    """Its logits, if there are any, are its own, tell views apart, and make the weights."""
    strategy, tokens, slots = example(settings), tokens_of(POINTS, K), slots_of(POINTS)
    if not strategy.ranks_views:
        return
    logits = strategy.selection_logits(tokens)
    assert logits.shape[:-1] == (POINTS, K)
    alone = [strategy.selection_logits(tokens[:, i : i + 1]) for i in range(K)]
    assert_close(torch.cat(alone, 1), logits)
    assert (logits[:, 1:] - logits[:, :1]).abs().max() > 0.01
    shares = logits.exp() * slots[..., None]
    expected = (shares / shares.sum(1, keepdim=True)).mean(-1)
    assert_close(strategy(tokens, slots)[1], expected)


def half_precision_is_near(settings: Any) -> None:
    """Under bfloat16's autocast, as ``online.precision`` may ask for it."""
    strategy, tokens, slots = example(settings), tokens_of(POINTS, K), slots_of(POINTS)
    expected, _ = strategy(tokens, slots)
    with torch.autocast("cpu", torch.bfloat16), torch.inference_mode():
        fused, _ = strategy(tokens, slots)
    assert_close(fused.float(), expected, atol=0.3, rtol=0.1)


def its_settings_shape_weights(settings: Any) -> None:
    """Of other values it is another training, not one that is reused."""
    for field in fields(FUSIONS.settings(settings)):
        assert field.metadata["shapes"] == "weights", f'{field.name}: shapes="weights" is missing'


CHECKS = (
    weights_are_shares,
    leading_shapes_are_any,
    empty_slots_say_nothing,
    order_matters_if_it_says_so,
    voxels_without_views_stay_finite,
    a_view_is_ranked_by_itself,
    half_precision_is_near,
    its_settings_shape_weights,
)
