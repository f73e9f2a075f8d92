"""The embedded flats: closed, connected, walked through, filmed as said."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tf_lab import geometry
from tf_lab.data.flats import Flat, generate_flat, make_flat
from tf_lab.data.flats.contents import tops
from tf_lab.data.flats.plan import FlatPlan, make_flat_plan
from tf_lab.data.rooms import RoomSettings
from tf_lab.data.rooms.footprint import overlap
from tf_lab.data.scene import Frame, write_scene
from tf_lab.data.visibility import measure_visibility

SEEDS = (1, 6)
FILM = RoomSettings(width=48, height=36, frames=50, samples=1)


@pytest.fixture(scope="module")
def plans() -> list[FlatPlan]:
    return [make_flat_plan(np.random.default_rng(seed)) for seed in range(150)]


@pytest.fixture(scope="module", params=SEEDS)
def seed(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(scope="module")
def flat(seed: int) -> Flat:
    return make_flat(seed)


@pytest.fixture(scope="module")
def mesh(flat: Flat) -> trimesh.Trimesh:
    return flat.geometry.mesh()


@pytest.fixture(scope="module")
def frames(seed: int) -> list[Frame]:
    return list(generate_flat(seed, FILM))


def test_one_to_five_rooms_all_connected(plans: list[FlatPlan]) -> None:
    assert set(Counter(len(plan.rooms) for plan in plans)) == {1, 2, 3, 4, 5}
    assert any(plan.corridor is not None for plan in plans)
    for plan in plans:
        n = len(plan.rooms)
        pairs = np.array([passage.rooms for passage in plan.passages]).reshape(-1, 2).T
        graph = coo_matrix((np.ones(pairs.shape[1]), tuple(pairs)), shape=(n, n))
        assert connected_components(graph, directed=False)[0] == 1


def test_rooms_and_passages_touch_and_never_overlap(plans: list[FlatPlan]) -> None:
    for plan in plans:
        rects = np.array([room.rects[0] for room in plan.rooms])
        sides = rects[:, 2:] - rects[:, :2]
        assert sides.min() > 1.0 and sides.max() < 9
        for i, a in enumerate(rects):
            for b in rects[:i]:
                gap = np.maximum(a[:2] - b[2:], b[:2] - a[2:]).max()
                assert gap > 0.1, "a wall between"
        for passage in plan.passages:
            x0, y0, x1, y1 = passage.rect
            size = sorted((x1 - x0, y1 - y0))
            assert 0.1 < size[0] < 0.21 and 0.8 <= size[1] <= 1.0
            for number in passage.rooms:  # its end is on the room's border, inside its extent
                a = rects[number]
                shared = np.minimum([x1, y1], a[2:]) - np.maximum([x0, y0], a[:2])
                np.testing.assert_allclose(sorted(shared), [0, size[1]], atol=1e-9)


def test_a_passage_is_open_on_both_sides(plans: list[FlatPlan]) -> None:
    """Each room has it in a wall of its own, at the same place of the world."""
    for plan in plans:
        ends = [np.array([p.rect[:2], p.rect[2:]]) for p in plan.passages for _ in range(2)]
        openings = []
        for room in plan.rooms:
            for wall in room.walls:
                along = (wall.b - wall.a) / wall.length
                out = np.array([along[1], -along[0]])
                for o in wall.openings:
                    if o.kind == "passage":
                        spots = [
                            wall.a + along * s + out * d
                            for s in (o.start, o.end)
                            for d in (0, o.depth)
                        ]
                        openings.append(np.array([np.min(spots, 0), np.max(spots, 0)]))
        assert len(openings) == len(ends)
        area = [np.prod(b - a) for a, b in openings]
        assert sum(area) == pytest.approx(sum(np.prod(b - a) for a, b in ends) / 2)
        for low, high in openings:
            assert any((low >= a - 1e-9).all() and (high <= b + 1e-9).all() for a, b in ends)


def test_only_outer_walls_have_windows_doors_and_niches(plans: list[FlatPlan]) -> None:
    kinds = Counter()
    for plan in plans:
        rects = np.array([room.rects[0] for room in plan.rooms])
        low, high = rects[:, :2].min(0), rects[:, 2:].max(0)
        for room in plan.rooms:
            for wall in room.walls:
                middle = (wall.a + wall.b) / 2
                outer = np.minimum(np.abs(middle - low), np.abs(middle - high)).min() < 1e-6
                for o in wall.openings:
                    kinds[o.kind] += 1
                    assert outer or o.kind == "passage"
    assert min(kinds[kind] for kind in ("window", "door", "niche", "passage")) > 20


def test_nothing_intersects_and_everything_is_in_a_room(flat: Flat) -> None:
    for i, a in enumerate(flat.placed):
        assert any(room.inside(a.corners).all() for room in flat.plan.rooms), a.name
        for b in flat.placed[:i]:
            assert not overlap(a.corners, b.corners, 0.0), (a.name, b.name)
    assert max(piece.height for piece in flat.placed) > 1.7, "something hides what is behind"


def test_same_seed_same_flat_other_seed_other_flat() -> None:
    small = RoomSettings(width=32, height=24, frames=4, samples=2)
    a, b, c = (list(generate_flat(number, small)) for number in (5, 5, 8))
    for x, y in zip(a, b, strict=True):
        for name in ("image", "depth", "world_T_cam", "K"):
            assert np.array_equal(getattr(x, name), getattr(y, name))
    assert not np.array_equal(a[0].image, c[0].image)
    assert not np.array_equal(a[0].K, c[0].K)


def test_one_camera_of_50_to_75_degrees(frames: list[Frame], flat: Flat) -> None:
    assert len(frames) == FILM.frames * len(flat.plan.rooms)
    K = frames[0].K
    assert 50 <= np.degrees(2 * np.arctan(FILM.width / 2 / K[0, 0])) <= 75
    for f in frames:
        assert np.array_equal(f.K, K)
        assert f.depth is not None and (f.depth > 0).all(), "closed: every ray hits something"
        assert 15 < f.image.mean() < 240
    assert np.mean([f.image.std() > 8 for f in frames]) > 0.95


def test_the_walk_goes_through_every_room(frames: list[Frame], flat: Flat) -> None:
    centres = np.stack([f.world_T_cam[:3, 3] for f in frames])
    for room in flat.plan.rooms:
        assert room.inside(centres[:, :2]).sum() >= 5
    assert flat.plan.floor.inside(centres[:, :2]).all()
    assert centres[:, 2].min() >= 1.1 and centres[:, 2].max() <= 1.7


def test_the_camera_keeps_clear_and_sees_front_sides(
    frames: list[Frame], mesh: trimesh.Trimesh
) -> None:
    centres = np.stack([f.world_T_cam[:3, 3] for f in frames[::3]])
    sphere = trimesh.creation.icosphere(subdivisions=2).vertices
    origins = np.repeat(centres, len(sphere), axis=0)
    rays = np.tile(sphere, (len(centres), 1))
    hits, index, faces = mesh.ray.intersects_location(origins, rays, multiple_hits=False)
    assert len(index) == len(rays), "inside the closed flat"
    assert np.linalg.norm(hits - origins[index], axis=1).min() > 0.22
    outward = np.einsum("ij,ij->i", mesh.face_normals[faces], rays[index])
    assert (outward < 0).mean() > 0.995, "inside no furniture, and no way between the walls"


def test_depth_is_camera_z_at_the_stored_pose(frames: list[Frame], mesh: trimesh.Trimesh) -> None:
    rng = np.random.default_rng(0)
    for f in frames[::20]:
        K, pose = torch.tensor(f.K), torch.tensor(f.world_T_cam)
        rows, columns = rng.integers(0, 36, 60), rng.integers(0, 48, 60)
        camera = geometry.pixel_directions(K, (48, 36))[rows, columns]
        rays = (camera @ pose[:3, :3].T).numpy()
        origins = np.tile(f.world_T_cam[:3, 3], (60, 1))
        hits, index, _ = mesh.ray.intersects_location(origins, rays, multiple_hits=False)
        _, z = geometry.project(torch.tensor(hits), K, geometry.invert_pose(pose))
        assert f.depth is not None
        close = np.abs(f.depth[rows, columns][index] - z.numpy()) < 0.002
        assert len(index) == 60 and close.mean() > 0.95  # a ray may pass an edge on either side


def test_tables_are_filmed_from_near() -> None:
    """Some frames look down at a top, whose point in the middle of the image is 0.5-1.3 m away.

    In a flat of two rooms: so short a walk through five has hardly time for more than the rooms.
    """
    flat, near = make_flat(1), 0
    for f in generate_flat(1, FILM):
        assert f.depth is not None
        eye, forward = f.world_T_cam[:3, 3], f.world_T_cam[:3, 2]
        spot = eye + forward * f.depth[18, 24]
        away = np.linalg.norm(spot - eye)
        on_top = any(
            p.contains(spot[:2]) and top - 0.05 < spot[2] < top + 0.5
            for p, top in tops(flat.placed)
        )
        near += on_top and 0.5 < away < 1.3 and forward[2] < -0.3
    assert near >= 3


def views_of(seed: int, settings: RoomSettings, directory: Path) -> tuple[float, float]:
    """Share visible and median views, of surface points taken from the depth maps themselves."""
    scene = write_scene(directory, generate_flat(seed, settings), {}, "flat")
    rng = np.random.default_rng(0)
    points = []
    for i in range(len(scene)):
        depth = torch.tensor(scene.depth(i))
        v, u = rng.integers(0, settings.height, 300), rng.integers(0, settings.width, 300)
        rays = geometry.pixel_directions(torch.tensor(scene.K[i]), scene.size)[v, u]
        world = geometry.transform(torch.tensor(scene.world_T_cam[i]), rays * depth[v, u, None])
        points.append(world.numpy())
    cloud = np.concatenate(points)
    _, first = np.unique((cloud / 0.1).round(), axis=0, return_index=True)  # evenly spread
    found = measure_visibility(scene, range(len(scene)), cloud[first][::5])
    return found.share, found.median


def test_much_is_hidden(tmp_path: Path) -> None:
    """In the mean of two test flats, with few frames."""
    found = [views_of(2_000_000 + i, FILM, tmp_path / f"flat{i}") for i in (3, 7)]
    share, median = np.mean(found, axis=0)
    assert share < 0.6
    assert median > 3


@pytest.mark.slow
def test_test_flats_are_seen_by_many(tmp_path: Path) -> None:
    """As many frames as conf/data/flats.yaml has, small ones."""
    settings = RoomSettings(width=80, height=60, frames=230, samples=1)
    found = [views_of(2_000_000 + i, settings, tmp_path / f"flat{i}") for i in (3, 7)]
    share, median = np.mean(found, axis=0)
    assert share < 0.6
    assert median >= 25
