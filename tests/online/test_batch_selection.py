"""Training keeps the views that the view store keeps online, whatever the policy."""

import pytest
import torch
from scipy.stats import chi2
from torch import Tensor

from tf_lab.online.views import POLICIES, make_policy
from tf_lab.online.views.batch import BatchSelection
from tf_lab.online.views.selection import DiverseSelection, SelectionPolicy
from tf_lab.online.views.store import ViewStore

P, V, H = 300, 14, 2


def voxels(seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Logits [P, V, H], which views are valid [P, V], and cameras beside the voxels [P, V, 3]."""
    generator = torch.Generator().manual_seed(seed)
    logits = torch.randn(P, V, H, generator=generator)
    valid = torch.rand(P, V, generator=generator) < 0.7
    valid[0], valid[1], valid[2] = False, True, torch.arange(V) == V - 1
    return logits, valid, 2 * torch.randn(P, V, 3, generator=generator)


def online(
    policy: SelectionPolicy, views: int, logits: Tensor, valid: Tensor, centers: Tensor
) -> Tensor:
    """Frames int32 [P, K] that a view store holds after the views came one by one."""
    store = ViewStore(views, H if policy.needs_logits else 0, policy, logits=torch.float32)
    store.grow(P)
    keys = torch.arange(P)[:, None].expand(P, 3)
    for view in range(V):
        rows = valid[:, view].nonzero().squeeze(1)
        held = store.frames[rows].long()
        shown = torch.cat([held.clamp(min=0), torch.full((len(rows), 1), view)], 1)
        store.add(
            view,
            rows,
            keys[rows],
            logits[rows, view] if policy.needs_logits else None,
            centers[rows[:, None], shown],
        )
    return store.frames


def rows(valid: Tensor) -> Tensor:
    """Keys [P, 3] of voxels, as `online` gives them to the store."""
    return torch.arange(len(valid))[:, None].expand(-1, 3)


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


@pytest.mark.parametrize(
    "policy", [*(make_policy(part.name, 5) for part in POLICIES), DiverseSelection(6, spread=0.5)]
)
@pytest.mark.parametrize("views", [1, 4, V, V + 3])
def test_training_keeps_what_the_store_keeps(policy: SelectionPolicy, views: int) -> None:
    logits, valid, centers = voxels()
    given = logits if policy.needs_logits else None
    kept, filled = BatchSelection(policy, views)(given, valid, centers, rows(valid))
    expected = online(policy, views, logits, valid, centers)[:, : kept.shape[1]]
    assert torch.equal(filled, expected >= 0)
    assert torch.equal(kept[filled], expected[filled].long())
    assert valid.gather(1, kept)[filled].all()
    assert (filled.sum(1) == valid.sum(1).clamp(max=views)).all()


@pytest.mark.parametrize("name", [policy.name for policy in POLICIES])
def test_what_invalid_views_say_does_not_matter(name: str) -> None:
    logits, valid, centers = voxels()
    select = BatchSelection(make_policy(name, 1), 4)
    kept, filled = select(logits, valid, centers, rows(valid))
    rubbish = ~valid[..., None]
    again, _ = select(
        logits.masked_fill(rubbish, 1e4),
        valid,
        centers.masked_fill(rubbish, torch.nan),
        rows(valid),
    )
    assert torch.equal(again[filled], kept[filled])


def test_random_views_differ_between_voxels_and_are_all_alike() -> None:
    """Not the same few for all voxels: each is kept K / V of the time, whichever it is."""
    valid, nowhere = torch.ones(4000, V, dtype=torch.bool), torch.zeros(4000, V, 3)
    kept, _ = BatchSelection(make_policy("random", 3), 4)(None, valid, nowhere, rows(valid))
    count = torch.bincount(kept.flatten(), minlength=V).double()
    p = 4 / V
    spread = 4000 * p * (1 - p) * V / (V - 1)
    assert ((count - 4000 * p) ** 2 / spread).sum() < chi2.ppf(0.999, V - 1)
    assert len(kept.sort(1).values.unique(dim=0)) > 900  # of 1001 subsets
    other, _ = BatchSelection(make_policy("random", 4), 4)(None, valid, nowhere, rows(valid))
    assert (other != kept).any(1).float().mean() > 0.9


def test_without_logits_chance_decides() -> None:
    _, valid, centers = voxels()
    kept, filled = BatchSelection(make_policy("attention", 2), 4)(None, valid, centers, rows(valid))
    expected, _ = BatchSelection(make_policy("random", 2), 4)(None, valid, centers, rows(valid))
    assert torch.equal(kept[filled], expected[filled])
