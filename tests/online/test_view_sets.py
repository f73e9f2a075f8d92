"""What view sets are worth, in a room whose depth and occlusions are known."""

import numpy as np
import pytest
import torch
from torch import Tensor

from helpers import box_room
from helpers.online.scenes import FRAMES, Factory, balanced, reconstruct
from tf_lab.data.scene import Scene
from tf_lab.evaluation.scenes import surface_views
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.views.statistics import ViewSets, view_sets

DEPTHS = [torch.from_numpy(box_room.depth_image(box_room.poses()[i])).float() for i in FRAMES]


def near_the_box(r: Reconstructor) -> Tensor:
    """Rows of coarse voxels whose centre lies in the box or up to 35 cm from its walls."""
    rows = torch.arange(r.coarse.blocks.rows)
    points = r.coarse.points(rows).numpy()
    inside = ((points > box_room.BOX[0] - 0.35) & (points < box_room.BOX[1] + 0.35)).all(1)
    return rows[torch.from_numpy(inside)]


def hidden(r: Reconstructor, row: int, frame: int, margin: float) -> bool:
    """Whether the box, grown by a margin (metres), hides a voxel's centre from a frame."""
    point = r.coarse.points(torch.tensor([row]))[0].double().numpy()
    eye = box_room.poses()[FRAMES[frame]][:3, 3]
    path = eye + np.linspace(0, 1, 2000)[:, None] * (point - eye)
    path = path[np.linalg.norm(path - point, axis=1) > r.coarse.voxel * 1.8]
    low, high = box_room.BOX[0] - margin, box_room.BOX[1] + margin
    return bool(((path > low) & (path < high)).all(1).any())


def test_all_views_held_are_as_visible_as_all_views(tiny_network: Factory, scene: Scene) -> None:
    r = reconstruct(tiny_network(), scene, views=len(FRAMES), select="random")
    found = view_sets(r.coarse, near_the_box(r), DEPTHS)
    assert found.voxels > 20
    assert found.visible == found.visible_of_all
    assert 0.5 < found.visible < 1


def test_what_is_behind_the_box_is_hidden_and_nothing_else(
    tiny_network: Factory, scene: Scene
) -> None:
    """One view a voxel, by a ray marched from the camera; 8 cm is what a pixel may miss."""
    r = reconstruct(tiny_network(), scene, views=1, select="random", seed=1)
    points = r.coarse.points(torch.arange(r.coarse.blocks.rows)).numpy()
    inside = ((points > box_room.ROOM[0]) & (points < box_room.ROOM[1])).all(1)
    count = {True: 0, False: 0}
    for row in (r.coarse.store.seen > 0).nonzero().squeeze(1).tolist():
        frame = int(r.coarse.store.frames[row, 0])
        found = view_sets(r.coarse, torch.tensor([row]), DEPTHS)
        assert (found.voxels, found.views) == (1, 1)
        if hidden(r, row, frame, -0.08):
            assert found.visible == 0
            count[True] += 1
        elif inside[row] and not hidden(r, row, frame, 0.4):
            assert found.visible == 1
            count[False] += 1
    assert count[True] >= 5
    assert count[False] > 50


def test_spread_and_variety_by_hand(tiny_network: Factory, scene: Scene) -> None:
    r = reconstruct(tiny_network(), scene, views=2, select="attention")
    level, rows = r.coarse, near_the_box(r)
    found = view_sets(level, rows, DEPTHS)
    angles, counts = [], []
    for row in rows[level.store.filled[rows].any(1)].tolist():
        held = [f for f in level.store.frames[row].tolist() if f >= 0]
        if len(held) == 2:
            point = level.points(torch.tensor([row]))[0].numpy()
            a, b = (box_room.poses()[FRAMES[f]][:3, 3] - point for f in held)
            angles.append(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
        voxel = level.blocks.voxels(torch.tensor([row]))[0]
        around = voxel + torch.cartesian_prod(*[torch.arange(-1, 2)] * 3)
        near = level.blocks.row_of(around)
        counts.append(
            len({f for f in level.store.frames[near[near >= 0]].flatten().tolist()} - {-1})
        )
    assert found.spread == pytest.approx(np.degrees(np.mean(angles)), abs=1e-3)
    assert found.variety == pytest.approx(np.mean(counts))


def test_of_no_voxels_nothing_is_said(tiny_network: Factory, scene: Scene) -> None:
    r = reconstruct(tiny_network(), scene, views=2)
    nothing = view_sets(r.coarse, torch.empty(0, dtype=torch.int64), DEPTHS)
    assert nothing == ViewSets(0, 0, 0, 0, 0, 0)


def test_unknown_depth_counts_neither_way(tiny_network: Factory, scene: Scene) -> None:
    r = reconstruct(tiny_network(), scene, views=3)
    unknown = [torch.zeros_like(depth) for depth in DEPTHS]
    blind = view_sets(r.coarse, near_the_box(r), unknown)
    assert (blind.visible, blind.visible_of_all) == (0, 0)
    half = view_sets(r.coarse, near_the_box(r), [DEPTHS[0], *unknown[1:]])
    assert 0 < half.visible_of_all <= 1


def test_random_sets_vary_more_between_neighbours(tiny_network: Factory, scene: Scene) -> None:
    network = tiny_network()
    by = {
        select: view_sets(r.coarse, (r.coarse.store.seen > 3).nonzero().squeeze(1), DEPTHS).variety
        for select in ("attention", "random")
        for r in [reconstruct(network, scene, views=2, select=select)]
    }
    assert by["random"] > by["attention"]


def test_a_scenes_view_sets_are_of_its_own_frames(tiny_network: Factory, scene: Scene) -> None:
    """Of the voxels at the analytic surface, by the analytic depth of the frames used."""
    r = reconstruct(balanced(tiny_network(), scene), scene, views=3)
    r.update()
    rows = torch.arange(r.fine.blocks.rows)
    distance = np.abs(box_room.signed_distance(r.fine.points(rows).double().numpy()))
    expected = view_sets(r.fine, rows[torch.from_numpy(distance < r.fine.voxel / 2)], DEPTHS)
    found = surface_views(r, scene, FRAMES)
    assert found.voxels == pytest.approx(expected.voxels, rel=0.2)
    assert found.visible == pytest.approx(expected.visible, abs=0.03)
    assert found.visible_of_all == pytest.approx(expected.visible_of_all, abs=0.03)
