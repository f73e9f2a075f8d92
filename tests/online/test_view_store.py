"""What the view store holds after frames were offered."""

import pytest
import torch
from hypothesis import given, strategies as st
from torch import Tensor

from tf_lab.online.lattice.blocks import Blocks
from tf_lab.online.views.selection import (
    AttentionSelection,
    Candidates,
    RandomSelection,
    SelectionPolicy,
)
from tf_lab.online.views.store import ViewStore

VOXELS, HEADS = 9, 2


def logits_of(frame: int, voxels: Tensor) -> Tensor:
    """Logits that tell the frame and voxel they belong to."""
    signs = torch.tensor([1.0, -0.5])
    return torch.sin(frame * 7.1 + voxels.float() * 1.3)[:, None] * signs + frame / 64


def fill(policy: SelectionPolicy, views: int, sights: list[list[int]]) -> ViewStore:
    keys = torch.stack([torch.arange(VOXELS)] * 3, 1)
    store = ViewStore(views, HEADS if policy.needs_logits else 0, policy, logits=torch.float32)
    store.grow(VOXELS)
    for frame, voxels in enumerate(sights):
        index = torch.tensor(sorted(voxels), dtype=torch.int64)
        store.add(
            frame, index, keys[index], logits_of(frame, index) if policy.needs_logits else None
        )
    return store


sequences = st.lists(st.lists(st.integers(0, VOXELS - 1), unique=True), max_size=14)


@given(views=st.integers(1, 6), sights=sequences)
@pytest.mark.parametrize("policy", [AttentionSelection(), RandomSelection(2)])
def test_invariants(policy: SelectionPolicy, views: int, sights: list[list[int]]) -> None:
    store = fill(policy, views, sights)
    assert store.frames.shape == (VOXELS, views)
    assert torch.equal(store.filled, store.frames >= 0)
    for voxel in range(VOXELS):
        saw = [frame for frame, voxels in enumerate(sights) if voxel in voxels]
        held = store.frames[voxel][store.filled[voxel]].tolist()
        assert store.seen[voxel] == len(saw)
        assert len(held) == min(views, len(saw))
        assert len(set(held)) == len(held)
        assert set(held) <= set(saw)
        if len(saw) <= views:
            assert held == saw  # in their order, in the first slots
        if policy.needs_logits and saw:
            assert saw[-1] in held  # the latest is always added (paper, Sec. 3.4)


@given(views=st.integers(1, 4), sights=sequences)
def test_logits_belong_to_the_frames(views: int, sights: list[list[int]]) -> None:
    store = fill(AttentionSelection(), views, sights)
    voxel, slot = store.filled.nonzero(as_tuple=True)
    for v, s in zip(voxel.tolist(), slot.tolist(), strict=True):
        expected = logits_of(int(store.frames[v, s]), torch.tensor([v]))[0]
        torch.testing.assert_close(store.logits[v, s], expected)


def test_a_random_store_keeps_no_logits() -> None:
    store = fill(RandomSelection(), 3, [[0, 1], [1, 2]])
    assert store.logits.numel() == 0


def test_a_frame_that_sees_nothing() -> None:
    for policy in (AttentionSelection(), RandomSelection()):
        store = fill(policy, 2, [[], [3], []])
        assert store.seen.sum() == 1


def test_memory_per_voxel() -> None:
    """The paper's 4 heads and K = 16, keys of the blocks included."""
    store = ViewStore(16, 4, AttentionSelection())
    blocks = Blocks(3, torch.device("cpu"))
    blocks.allocate(torch.randint(-99, 99, (50, 3)))
    store.grow(blocks.rows)
    assert store.frames.shape == (blocks.rows, 16)
    assert (store.nbytes + blocks.nbytes) / blocks.rows <= 200
    assert store.nbytes == sum(c.nbytes for c in (store.frames, store.logits, store.seen)) + len(
        store.dirty
    )


def test_growing_keeps_what_is_there() -> None:
    grown = ViewStore(3, HEADS, AttentionSelection())
    whole = ViewStore(3, HEADS, AttentionSelection())
    whole.grow(40)
    for frame in range(12):
        grown.grow(4 + 3 * frame)
        rows = torch.arange(frame, 4 + 3 * frame, 2)
        for store in (grown, whole):
            store.add(frame, rows, rows[:, None].expand(-1, 3), logits_of(frame, rows))
    rows = len(grown.frames)
    for name in ("frames", "logits", "seen", "dirty"):
        assert torch.equal(getattr(grown, name), getattr(whole, name)[:rows])
    assert (whole.frames[rows:] == -1).all()


def test_dirty_means_that_the_view_set_changed() -> None:
    rows = torch.arange(200)
    keys = rows[:, None].expand(-1, 3)
    for policy in (AttentionSelection(), RandomSelection(1)):
        store = ViewStore(2, HEADS if policy.needs_logits else 0, policy)
        store.grow(len(rows))
        assert not store.dirty.any()
        for frame in range(9):
            before = store.frames.clone()
            store.dirty[:] = False
            logits = logits_of(frame, rows) if policy.needs_logits else None
            store.add(frame, rows, keys, logits)
            assert torch.equal(store.dirty, (store.frames != before).any(1))
        assert store.dirty.all() == policy.needs_logits


def test_huge_logits_stay_finite() -> None:
    store = ViewStore(2, 1, AttentionSelection())
    store.grow(1)
    for frame, value in enumerate((1e9, -1e9, 3.0)):
        row = torch.tensor([0])
        store.add(frame, row, row[:, None].expand(-1, 3), torch.tensor([[value]]))
    assert store.frames.tolist() == [[0, 2]]
    assert store.logits.isfinite().all()


class Refuses:
    """Keeps no new view, once all slots are full."""

    needs_logits, needs_centers, needs_chance = False, True, False

    def drop(self, candidates: Candidates) -> Tensor:
        self.centers = candidates.centers
        return torch.full_like(candidates.seen, candidates.frames.shape[1] - 1)


def test_a_view_that_is_not_kept_changes_nothing_that_is_told() -> None:
    policy = Refuses()
    store = ViewStore(1, HEADS, policy)
    store.grow(2)
    rows, keys, centers = torch.arange(2), torch.zeros(2, 3).long(), torch.rand(2, 2, 3)
    assert store.add(5, rows, keys, None, centers).tolist() == [0, 0]
    assert store.add(6, rows, keys, None, centers).tolist() == [-1, -1]
    assert policy.centers is centers
    assert store.frames.tolist() == [[5], [5]]
    assert store.dirty.all()  # since the first
    assert store.seen.tolist() == [2, 2]
