"""What `tf_lab.online.views.selection` promises of a policy, as checks.

Tests run every registered policy through them. For one of your own::

    for check in CHECKS:
        check("mine")  # or its settings; an AssertionError says what it does not keep
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import torch
from torch import Tensor

from tf_lab.online.views import POLICIES, make_policy
from tf_lab.online.views.batch import BatchSelection
from tf_lab.online.views.selection import Candidates, SelectionPolicy
from tf_lab.online.views.store import ViewStore

VOXELS, FRAMES, HEADS = 200, 14, 2


def sights(seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Logits [P, V, H], which frames see the voxels [P, V], cameras beside these [P, V, 3]."""
    generator = torch.Generator().manual_seed(seed)
    logits = torch.randn(VOXELS, FRAMES, HEADS, generator=generator)
    valid = torch.rand(VOXELS, FRAMES, generator=generator) < 0.7
    valid[0], valid[1], valid[2] = False, True, torch.arange(FRAMES) == FRAMES - 1
    return logits, valid, 2 * torch.randn(VOXELS, FRAMES, 3, generator=generator)


def keys_of(count: int) -> Tensor:
    """Keys [P, 3] of voxels."""
    return torch.arange(count)[:, None].expand(-1, 3)


def kept_online(
    policy: SelectionPolicy, views: int, logits: Tensor, valid: Tensor, centers: Tensor
) -> Tensor:
    """Frames int64 [P, K] that a view store holds after the frames came one by one."""
    store = ViewStore(views, HEADS if policy.needs_logits else 0, policy, logits=torch.float32)
    store.grow(len(valid))
    for frame in range(valid.shape[1]):
        rows = valid[:, frame].nonzero().squeeze(1)
        held = store.frames[rows].long().clamp(min=0)
        shown = torch.cat([held, torch.full((len(rows), 1), frame)], 1)
        store.add(
            frame,
            rows,
            keys_of(len(valid))[rows],
            logits[rows, frame] if policy.needs_logits else None,
            centers[rows[:, None], shown] if policy.needs_centers else None,
        )
    return store.frames.long()


def it_is_of_its_seed(settings: Any) -> None:
    """And says so."""
    assert [make_policy(settings, seed).seed for seed in (0, 7)] == [0, 7]


def it_drops_one_of_the_candidates(settings: Any) -> None:
    """The same of the same, each voxel by itself, and without touching what it is given."""
    policy = make_policy(settings, 3)
    logits, _, centers = sights()
    frames = torch.arange(5).expand(VOXELS, 5).contiguous()
    seen = torch.arange(VOXELS) % 9 + 4

    def drop(rows: Tensor) -> Tensor:
        shown = Candidates(
            seen[rows],
            frames[rows],
            logits[rows, :5] if policy.needs_logits else None,
            centers[rows, :5] if policy.needs_centers else None,
            policy.chance(keys_of(VOXELS)[rows], seen[rows, None], frames[rows])
            if policy.needs_chance
            else None,
        )
        parts = [part for part in shown if part is not None]
        before = [part.clone() for part in parts]
        dropped = policy.drop(shown)
        assert all(map(torch.equal, parts, before)), "it changes its candidates"
        assert dropped.dtype == torch.int64 and dropped.shape == rows.shape
        assert ((dropped >= 0) & (dropped < 5)).all()
        return dropped

    order = torch.randperm(VOXELS, generator=torch.Generator().manual_seed(0))
    whole, parts = drop(torch.arange(VOXELS)), torch.cat([drop(p) for p in order.split(37)])
    assert torch.equal(parts, whole[order]), "a voxel's choice depends on the others"


def training_keeps_what_the_store_keeps(settings: Any) -> None:
    """All frames while there is room, then K of those that see the voxel."""
    policy = make_policy(settings, 5)
    logits, valid, centers = sights()
    given = logits if policy.needs_logits else None
    for views in (1, 4, FRAMES, FRAMES + 3):
        kept, filled = BatchSelection(policy, views)(given, valid, centers, keys_of(VOXELS))
        expected = kept_online(policy, views, logits, valid, centers)[:, : kept.shape[1]]
        assert torch.equal(filled, expected >= 0)
        assert torch.equal(kept[filled], expected[filled])
        assert valid.gather(1, kept)[filled].all()
        assert (filled.sum(1) == valid.sum(1).clamp(max=views)).all()


def frames_that_see_nothing_say_nothing(settings: Any) -> None:
    """Whatever their logits and cameras are."""
    logits, valid, centers = sights()
    select = BatchSelection(make_policy(settings, 1), 4)
    kept, filled = select(logits, valid, centers, keys_of(VOXELS))
    rubbish = ~valid[..., None]
    others = logits.masked_fill(rubbish, 1e4), centers.masked_fill(rubbish, torch.nan)
    again, _ = select(others[0], valid, others[1], keys_of(VOXELS))
    assert torch.equal(again[filled], kept[filled])


def its_settings_shape_scores(settings: Any) -> None:
    """Of other values it is another evaluation, not one that is reused."""
    for field in fields(POLICIES.settings(settings)):
        assert field.metadata["shapes"] == "scores", f'{field.name}: shapes="scores" is missing'


CHECKS = (
    it_is_of_its_seed,
    it_drops_one_of_the_candidates,
    training_keeps_what_the_store_keeps,
    frames_that_see_nothing_say_nothing,
    its_settings_shape_scores,
)
