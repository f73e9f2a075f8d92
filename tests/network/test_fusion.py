"""All fusion strategies against the contract, and each against its definition written out."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from tf_lab.errors import TFLabError
from tf_lab.network.fusion import FUSIONS, FusionPart, make_fusion
from tf_lab.network.fusion.contract import CHECKS, HEADS, D, K, example, slots_of, tokens_of
from tf_lab.network.fusion.strategy import Fusion, check_outputs
from tf_lab.network.fusion.transformer import _attend_by_products
from tf_lab.support.registry import Part
from tf_lab.support.settings import setting


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("part", list(FUSIONS), ids=lambda part: part.name)
def test_contract(part: Part, check: Callable[[Any], None]) -> None:
    check(part.name)


@dataclass(frozen=True)
class NoiseSettings:
    """Another loudness is no other training."""

    strategy: str = setting("noise", shapes="weights")
    loudness: float = setting(1.0)


class Noise(Fusion):
    """Keeps none of it."""

    ranks_views = True

    def __init__(self, *sizes: Any, loudness: float) -> None:
        super().__init__(*sizes)

    def selection_logits(self, tokens: Tensor) -> Tensor:
        return torch.randn(*tokens.shape[:-1], HEADS)

    def forward(self, tokens: Tensor, slots: Tensor | None = None) -> tuple[Tensor, Tensor]:
        return torch.randn_like(tokens[..., 0, :]), torch.randn_like(tokens[..., 0])


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_the_contract_can_be_broken(
    check: Callable[[Any], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = FusionPart("noise", f"{__name__}:Noise", NoiseSettings)
    monkeypatch.setitem(FUSIONS._parts, "noise", noise)
    with pytest.raises(AssertionError):
        check({"strategy": "noise"})


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
    fusion: Any = example("transformer")
    views = tokens_of(K)
    with torch.no_grad():
        fused, weights = fusion(views)
        expected, attention = by_hand(fusion, views)
    # The last block of the module computes the fusion token only; the definition computes all.
    torch.testing.assert_close(fused, expected, atol=1e-5, rtol=1e-5)
    over_views = torch.stack([a[1:] / a[1:].sum() for a in attention])
    torch.testing.assert_close(weights, over_views.mean(0), atol=1e-6, rtol=1e-5)


def test_a_block_that_computes_some_outputs_agrees_with_all_of_them() -> None:
    transformer: Any = example("transformer")
    block = transformer.blocks[0]
    x = tokens_of(5, K)
    mask = slots_of(5)[:, None, None, :]
    for outputs in (1, 2):
        torch.testing.assert_close(block(x, mask, outputs), block(x, mask)[:, :outputs])


@pytest.mark.parametrize("name", ["avg", "pred", "gru"])
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
    fusion: Any = example("avg")
    tokens, slots = tokens_of(6, K), slots_of(6)
    fused, weights = fusion(tokens, slots)
    for point in range(6):
        views = tokens[point][slots[point]]
        mean = torch.stack([view_mlp(fusion.mlp, view) for view in views]).mean(0)
        torch.testing.assert_close(
            fused[point], layer_norm(mean, fusion.norm), atol=1e-5, rtol=1e-5
        )
        assert weights[point][slots[point]].tolist() == pytest.approx([1 / len(views)] * len(views))
    assert not fusion.ranks_views


def test_pred_is_the_mean_by_predicted_weights() -> None:
    fusion: Any = example("pred")
    tokens = tokens_of(6, K)
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


def sigmoid(x: Tensor) -> Tensor:
    return 1 / (1 + (-x).exp())


def test_gru_is_the_mean_of_its_states_by_predicted_weights() -> None:
    """The recurrence of Cho et al. 2014 written out, over the filled slots in their order."""
    fusion: Any = example({"strategy": "gru", "layers": 1})
    tokens, slots = tokens_of(6, K), slots_of(6)
    fused, weights = fusion(tokens, slots)
    w, u, b, c = (p.chunk(3) for p in fusion.gru.parameters())  # reset, update, new
    for point in range(6):
        views = tokens[point][slots[point]]
        state, states = torch.zeros(fusion.gru.hidden_size), []
        for view in views:
            x = fusion.input(view)
            reset, update = (sigmoid(w[i] @ x + b[i] + u[i] @ state + c[i]) for i in range(2))
            new = (w[2] @ x + b[2] + reset * (u[2] @ state + c[2])).tanh()
            state = (1 - update) * new + update * state
            states.append(fusion.output(state))
        score = fusion.score(views)[:, 0].exp()
        share = score / score.sum()
        torch.testing.assert_close(weights[point][slots[point]], share, atol=1e-5, rtol=1e-5)
        mean = (share[:, None] * torch.stack(states)).sum(0)
        expected = layer_norm(mean, fusion.norm)
        torch.testing.assert_close(fused[point], expected, atol=1e-4, rtol=1e-4)


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


class Wrong(Fusion):
    """Gives what it is told to."""

    ranks_views = False
    given: Any = None

    def forward(self, tokens: Tensor, slots: Tensor | None = None) -> Any:
        return self.given


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (torch.zeros(2, D), "gives no pair"),
        (
            (torch.zeros(2, D - 1), torch.ones(2, 3) / 3),
            r"features of \(2, 15\).*\(2, 16\) is wanted",
        ),
        (
            (torch.zeros(2, D), torch.ones(2, 3, 1) / 3),
            r"weights of \(2, 3, 1\).*\(2, 3\) is wanted",
        ),
        ((torch.zeros(2, D), torch.ones(2, 3)), "weights that sum to 3"),
    ],
)
def test_a_strategy_that_gives_something_else_is_named(given: Any, said: str) -> None:
    strategy = Wrong(D, 1, HEADS, 2.0)
    strategy.given = given
    with pytest.raises(TFLabError, match=said):
        check_outputs(strategy, D)
