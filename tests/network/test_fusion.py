"""All fusion strategies against the contract, and each against its definition written out."""

import math
from typing import Any

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor, nn

from tf_lab.network.fusion import FUSIONS, make_fusion
from tf_lab.network.fusion.transformer import _attend_by_products

D, K, HEADS = 16, 6, 4
NAMES = [part.name for part in FUSIONS]


def make(name: str, width: int = D, blocks: int = 3, heads: int = HEADS) -> Any:
    torch.manual_seed(3)
    module = make_fusion(name, width, blocks, heads, 2.0).eval()
    with torch.no_grad():  # away from the start's near-zero biases and its small fusion token
        for parameter in module.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))
    return module


def some_tokens(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, D, generator=torch.Generator().manual_seed(seed))


def some_slots(points: int, seed: int = 0) -> Tensor:
    """Random slots, at least one filled at each point."""
    slots = torch.rand(points, K, generator=torch.Generator().manual_seed(seed)) < 0.5
    slots[:, 0] |= ~slots.any(1)
    return slots


@pytest.fixture(params=NAMES)
def fusion(request: pytest.FixtureRequest) -> Any:
    return make(request.param)


@given(seed=st.integers(0, 1000))
@pytest.mark.parametrize("name", NAMES)
def test_weights_are_shares_of_the_filled_slots(name: str, seed: int) -> None:
    slots = some_slots(20, seed)
    fused, weights = make(name)(some_tokens(20, K, seed=seed), slots)
    assert fused.shape == (20, D)
    assert weights.shape == (20, K)
    assert (weights >= 0).all()
    assert (weights[~slots] == 0).all()
    torch.testing.assert_close(weights.sum(-1), torch.ones(20))


def test_leading_shapes_and_no_slots_at_all_given(fusion: Any) -> None:
    tokens = some_tokens(2, 5, K)
    fused, weights = fusion(tokens)
    assert fused.shape == (2, 5, D)
    assert weights.shape == (2, 5, K)
    masked, masked_weights = fusion(tokens, torch.ones(2, 5, K, dtype=torch.bool))
    torch.testing.assert_close(fused, masked, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(weights, masked_weights)
    one_by_one = torch.stack([fusion(t)[0] for t in tokens.flatten(0, 1)]).view_as(fused)
    torch.testing.assert_close(fused, one_by_one, atol=1e-5, rtol=1e-5)


@given(order=st.permutations(range(K)))
@pytest.mark.parametrize("name", NAMES)
def test_the_order_of_views_does_not_matter(name: str, order: list[int]) -> None:
    tokens, slots = some_tokens(10, K), some_slots(10)
    fusion = make(name)
    fused, weights = fusion(tokens, slots)
    again, permuted = fusion(tokens[:, order], slots[:, order])
    torch.testing.assert_close(again, fused, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(permuted, weights[:, order], atol=1e-5, rtol=1e-5)


def test_empty_slots_have_no_influence(fusion: Any) -> None:
    tokens, slots = some_tokens(10, K), some_slots(10)
    other = torch.where(slots[..., None], tokens, 100 * some_tokens(10, K, seed=9))
    fused, weights = fusion(tokens, slots)
    fused_other, weights_other = fusion(other, slots)
    torch.testing.assert_close(fused_other, fused, atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(weights_other, weights, atol=1e-6, rtol=1e-6)
    for point in range(10):  # and the same as without those slots
        alone, alone_weights = fusion(tokens[point][slots[point]])
        torch.testing.assert_close(alone, fused[point], atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(alone_weights, weights[point][slots[point]])


def test_a_point_without_views_stays_finite(fusion: Any) -> None:
    slots = some_slots(4)
    slots[2] = False
    tokens = some_tokens(4, K).requires_grad_()
    fused, weights = fusion(tokens, slots)
    assert torch.isfinite(fused).all()
    assert (weights[2] == 0).all()
    (fused.square().sum() + weights.square().sum()).backward()
    assert tokens.grad is not None
    assert torch.isfinite(tokens.grad).all()
    assert (tokens.grad[2] == 0).all()
    for parameter in fusion.parameters():
        assert parameter.grad is None or torch.isfinite(parameter.grad).all()


@pytest.mark.parametrize("name", ["transformer", "pred"])
def test_selection_logits_of_a_view_depend_on_that_view_alone(name: str) -> None:
    fusion, tokens = make(name), some_tokens(5, K)
    logits = fusion.selection_logits(tokens)
    alone = torch.stack(
        [fusion.selection_logits(tokens[:, i : i + 1])[:, 0] for i in range(K)],
        dim=1,
    )
    torch.testing.assert_close(logits, alone)
    changed = tokens.clone()
    changed[:, 1:] = 7.0
    torch.testing.assert_close(fusion.selection_logits(changed)[:, 0], logits[:, 0])
    assert (logits[:, 1:] - logits[:, :1]).abs().max() > 0.01


@pytest.mark.parametrize("name", ["transformer", "pred"])
def test_weights_are_the_softmax_of_the_selection_logits(name: str) -> None:
    fusion, tokens, slots = make(name), some_tokens(7, K), some_slots(7)
    logits = fusion.selection_logits(tokens)
    assert logits.shape == (7, K, HEADS if name == "transformer" else 1)
    share = logits.exp() * slots[..., None]
    expected = (share / share.sum(1, keepdim=True)).mean(-1)
    torch.testing.assert_close(fusion(tokens, slots)[1], expected)


def layer_norm(x: Tensor, norm: nn.LayerNorm) -> Tensor:
    centred = x - x.mean(-1, keepdim=True)
    deviation = (centred.square().mean(-1, keepdim=True) + norm.eps).sqrt()
    return centred / deviation * norm.weight + norm.bias


def by_hand(fusion: Any, views: Tensor) -> tuple[Tensor, list[Tensor]]:
    """Fusion token's output and its first-block attention [1 + K] per head, for views [K, D].

    The whole transformer, token by token, from the raw weight matrices.
    """
    x = torch.cat([fusion.token[None], views])
    first: list[Tensor] = []
    for number, block in enumerate(fusion.blocks):
        y = layer_norm(x, block.attention_norm)
        q, k, v = (
            y @ getattr(block, name).weight.T + getattr(block, name).bias
            for name in ("query", "key", "value")
        )
        size = D // HEADS
        read = torch.zeros_like(x)
        for head in range(HEADS):
            part = slice(head * size, (head + 1) * size)
            for i in range(len(x)):
                scores = torch.stack([q[i, part].dot(k[j, part]) for j in range(len(x))])
                share = (scores / math.sqrt(size)).exp()
                share = share / share.sum()
                read[i, part] = (share[:, None] * v[:, part]).sum(0)
                if number == 0 and i == 0:
                    first.append(share)
        x = x + read @ block.project.weight.T + block.project.bias
        norm, inner, _, outer = block.feed_forward
        hidden = (layer_norm(x, norm) @ inner.weight.T + inner.bias).clamp(min=0)
        x = x + hidden @ outer.weight.T + outer.bias
    return layer_norm(x[0], fusion.norm), first


def test_the_transformer_equals_its_definition() -> None:
    fusion = make("transformer")
    views = some_tokens(K)
    with torch.no_grad():
        fused, weights = fusion(views)
        expected, attention = by_hand(fusion, views)
    # The last block of the module computes the fusion token only; the definition computes all.
    torch.testing.assert_close(fused, expected, atol=1e-5, rtol=1e-5)
    over_views = torch.stack([a[1:] / a[1:].sum() for a in attention])
    torch.testing.assert_close(weights, over_views.mean(0), atol=1e-6, rtol=1e-5)


def test_a_block_that_computes_some_outputs_agrees_with_all_of_them() -> None:
    block = make("transformer").blocks[0]
    x = some_tokens(5, K)
    mask = some_slots(5)[:, None, None, :]
    for outputs in (1, 2):
        torch.testing.assert_close(block(x, mask, outputs), block(x, mask)[:, :outputs])


@pytest.mark.parametrize("name", ["avg", "pred"])
def test_ablations_have_the_transformers_size(name: str) -> None:
    def count(n: str) -> int:
        return sum(p.numel() for p in make_fusion(n, 256, 8, 4, 4.0).parameters())

    assert count(name) == pytest.approx(count("transformer"), rel=0.05)


def view_mlp(mlp: Any, x: Tensor) -> Tensor:
    for norm, inner, _, outer in mlp.blocks:
        hidden = (layer_norm(x, norm) @ inner.weight.T + inner.bias).clamp(min=0)
        x = x + hidden @ outer.weight.T + outer.bias
    return x


def test_avg_is_the_mean_of_what_each_view_says() -> None:
    fusion = make("avg")
    tokens, slots = some_tokens(6, K), some_slots(6)
    fused, weights = fusion(tokens, slots)
    for point in range(6):
        views = tokens[point][slots[point]]
        mean = torch.stack([view_mlp(fusion.mlp, view) for view in views]).mean(0)
        torch.testing.assert_close(
            fused[point], layer_norm(mean, fusion.norm), atol=1e-5, rtol=1e-5
        )
        assert weights[point][slots[point]].tolist() == pytest.approx([1 / len(views)] * len(views))
    assert fusion.selection_logits(tokens) is None


def test_pred_is_the_mean_by_predicted_weights() -> None:
    fusion = make("pred")
    tokens = some_tokens(6, K)
    fused, weights = fusion(tokens)
    assert weights.std(dim=1).min() > 1e-3  # they respond to the tokens
    for point in range(6):
        views = [view_mlp(fusion.mlp, view) for view in tokens[point]]
        score = torch.stack(
            [fusion.score.weight[0].dot(view) + fusion.score.bias[0] for view in views]
        )
        share = score.exp() / score.exp().sum()
        mean = sum(w * view for w, view in zip(share, views, strict=True))
        torch.testing.assert_close(weights[point], share, atol=1e-5, rtol=1e-5)
        assert isinstance(mean, Tensor)
        torch.testing.assert_close(
            fused[point], layer_norm(mean, fusion.norm), atol=1e-5, rtol=1e-5
        )


@pytest.mark.parametrize("masked", [False, True])
def test_attention_by_products_is_torchs(masked: bool) -> None:
    generator = torch.Generator().manual_seed(0)
    query, key, value = torch.randn(3, 50, 4, 9, 8, generator=generator, dtype=torch.float64)
    mask = None
    if masked:
        mask = torch.rand(50, 1, 1, 9, generator=generator) < 0.5
        mask[..., 0] = True
    expected = F.scaled_dot_product_attention(query[..., :2, :], key, value, attn_mask=mask)
    found = _attend_by_products(query[..., :2, :], key, value, mask)
    torch.testing.assert_close(found, expected)
