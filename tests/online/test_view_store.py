"""What the view store holds after frames were offered."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from tf_lab.online.selection import AttentionSelection, RandomSelection, SelectionPolicy
from tf_lab.online.view_store import ViewStore

VOXELS, HEADS = 9, 2


def logits_of(frame: int, voxels: Tensor) -> Tensor:
    """Logits that tell the frame and voxel they belong to."""
    signs = torch.tensor([1.0, -0.5])
    return torch.sin(frame * 7.1 + voxels.float() * 1.3)[:, None] * signs + frame / 64


def fill(policy: SelectionPolicy, views: int, sights: list[list[int]]) -> ViewStore:
    keys = torch.stack([torch.arange(VOXELS)] * 3, 1)
    store = ViewStore(keys, views, HEADS if policy.needs_weights else 0, policy)
    for frame, voxels in enumerate(sights):
        index = torch.tensor(sorted(voxels), dtype=torch.int64)
        store.add(frame, index, logits_of(frame, index) if policy.needs_weights else None)
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
        if policy.needs_weights and saw:
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
    """DESIGN: some 160 bytes at K = 16 and few heads, not K x D features."""
    store = ViewStore(torch.zeros(10, 3, dtype=torch.int64), 16, 2, AttentionSelection())
    held = store.frames.nbytes + store.logits.nbytes + store.seen.nbytes
    assert held / 10 <= 16 * (4 + 2 * 4) + 8
