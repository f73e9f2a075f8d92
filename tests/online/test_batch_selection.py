"""Training keeps the views that the view store keeps online, whatever the policy."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import pytest
import torch
from scipy.stats import chi2
from torch import Tensor

from tf_lab.online.views import POLICIES, PolicyPart, make_policy
from tf_lab.online.views.batch import BatchSelection
from tf_lab.online.views.contract import CHECKS, keys_of, sights
from tf_lab.online.views.selection import Candidates, angle_to_nearest

V = 14


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize(
    "settings", [*(part.name for part in POLICIES), {"policy": "diverse", "spread": 0.5}]
)
def test_contract(settings: Any, check: Callable[[Any], None]) -> None:
    check(settings)


@dataclass(frozen=True)
class Whim:
    """Keeps none of it."""

    some: int
    seed = 3
    needs_logits = needs_centers = needs_chance = False

    def drop(self, candidates: Candidates) -> Tensor:
        candidates.frames[:] = 0
        return torch.randint(0, candidates.frames.shape[1], candidates.seen.shape)


@pytest.mark.parametrize("check", CHECKS[:3], ids=lambda check: check.__name__)
def test_the_contract_can_be_broken(
    check: Callable[[Any], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    whim = PolicyPart("whim", f"{__name__}:Whim", POLICIES["random"].settings)
    monkeypatch.setitem(POLICIES._parts, "whim", whim)
    with pytest.raises(AssertionError):
        check({"policy": "whim"})


@dataclass(frozen=True)
class FarthestSelection:
    """Views from different directions: that goes which has another nearest beside it."""

    seed: int = 0
    needs_logits: ClassVar[bool] = False
    needs_centers: ClassVar[bool] = True
    needs_chance: ClassVar[bool] = False

    def drop(self, candidates: Candidates) -> Tensor:
        assert candidates.centers is not None
        return angle_to_nearest(candidates.centers).argmin(dim=1)


def test_views_from_different_directions_can_be_written(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From the cameras alone, with nothing else to do: it keeps the contract, and spreads."""
    part = PolicyPart("far", f"{__name__}:FarthestSelection", POLICIES["random"].settings)
    monkeypatch.setitem(POLICIES._parts, "far", part)
    for check in CHECKS:
        check({"policy": "far"})
    _, valid, centers = sights()
    spread = {}
    for name in ("far", "random"):
        policy = make_policy({"policy": name}, 0)
        kept, filled = BatchSelection(policy, 4)(None, valid, centers, keys_of(len(valid)))
        full = filled.all(1)
        chosen = torch.take_along_dim(centers[full], kept[full].unsqueeze(-1), dim=1)
        spread[name] = float(angle_to_nearest(chosen).mean())
    assert spread["far"] > 1.3 * spread["random"]


def test_chance_is_the_chunks_own_whatever_its_place_in_the_batch() -> None:
    """So that processes that share the chunks of a step learn as one that has them all."""
    valid, nowhere = torch.ones(60, V, dtype=torch.bool), torch.zeros(60, V, 3)
    keys = torch.stack([torch.arange(60) // 30, torch.arange(60) % 30, torch.zeros(60).long()], 1)
    both, first, second = torch.tensor([11, 12]), torch.tensor([11]), torch.tensor([12])

    def kept(draws: Tensor, part: slice) -> Tensor:
        own = keys[part] - keys[part][:1] * torch.tensor([1, 0, 0])
        select = BatchSelection(make_policy("random", 0), 4, draws)
        return select(None, valid[part], nowhere[part], own)[0]

    whole = kept(both, slice(0, 60))
    assert torch.equal(torch.cat([kept(first, slice(0, 30)), kept(second, slice(30, 60))]), whole)
    assert not torch.equal(whole[:30], whole[30:])


def test_random_views_differ_between_voxels_and_are_all_alike() -> None:
    """Not the same few for all voxels: each is kept K / V of the time, whichever it is."""
    valid, nowhere = torch.ones(4000, V, dtype=torch.bool), torch.zeros(4000, V, 3)
    keys = keys_of(len(valid))
    kept, _ = BatchSelection(make_policy("random", 3), 4)(None, valid, nowhere, keys)
    count = torch.bincount(kept.flatten(), minlength=V).double()
    p = 4 / V
    spread = 4000 * p * (1 - p) * V / (V - 1)
    assert ((count - 4000 * p) ** 2 / spread).sum() < chi2.ppf(0.999, V - 1)
    assert len(kept.sort(1).values.unique(dim=0)) > 900  # of 1001 subsets
    other, _ = BatchSelection(make_policy("random", 4), 4)(
        None, valid, nowhere, keys_of(len(valid))
    )
    assert (other != kept).any(1).float().mean() > 0.9


def test_without_logits_chance_decides() -> None:
    _, valid, centers = sights()
    shown = (None, valid, centers, keys_of(len(valid)))
    kept, filled = BatchSelection(make_policy("attention", 2), 4)(*shown)
    expected, _ = BatchSelection(make_policy("random", 2), 4)(*shown)
    assert torch.equal(kept[filled], expected[filled])
