"""The embedded rooms: seeded, well posed, geometrically and photometrically consistent."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch
import trimesh

from tf_lab import geometry
from tf_lab.data.rooms import Room, RoomSettings, generate_room, make_room
from tf_lab.data.rooms.footprint import overlap
from tf_lab.data.scene import Frame

SETTINGS = RoomSettings(frames=50)


@pytest.fixture(scope="module", params=[1, 2])
def seed(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(scope="module")
def frames(seed: int) -> list[Frame]:
    return list(generate_room(seed, SETTINGS))


@pytest.fixture(scope="module")
def mesh(seed: int) -> trimesh.Trimesh:
    return make_room(seed).geometry.mesh()


def test_shapes_and_names(frames: list[Frame]) -> None:
    assert [f.name for f in frames] == [f"{i:06d}" for i in range(SETTINGS.frames)]
    for f in frames:
        assert f.image.shape == (120, 160, 3) and f.image.dtype == np.uint8
        assert f.depth is not None and f.depth.shape == (120, 160) and f.depth.dtype == np.float32
        assert (f.depth > 0).all(), "rooms are closed: every ray hits something"
        assert f.image.std() > 5 and 20 < f.image.mean() < 235, "neither blank nor burnt out"


def test_same_seed_same_room_other_seed_other_room() -> None:
    small = RoomSettings(width=40, height=30, frames=3)
    a, b, c = (list(generate_room(s, small)) for s in (5, 5, 6))
    for x, y in zip(a, b, strict=True):
        assert np.array_equal(x.image, y.image)
        assert x.depth is not None and y.depth is not None
        assert np.array_equal(x.depth, y.depth)
        assert np.array_equal(x.world_T_cam, y.world_T_cam)
    assert not np.array_equal(a[0].image, c[0].image)
    five, six = (make_room(s).geometry.mesh() for s in (5, 6))
    assert five.vertices.shape != six.vertices.shape


def test_depth_is_camera_z_of_the_mesh(frames: list[Frame], mesh: trimesh.Trimesh) -> None:
    """Against trimesh's own ray caster and the project's pixel and camera conventions."""
    rng = np.random.default_rng(0)
    for f in frames[::12]:
        K, pose = torch.tensor(f.K), torch.tensor(f.world_T_cam)
        directions = geometry.pixel_directions(K, (160, 120))
        rows, columns = rng.integers(0, 120, 60), rng.integers(0, 160, 60)
        camera = directions[rows, columns]
        rays = (camera @ pose[:3, :3].T).numpy()
        origins = np.tile(f.world_T_cam[:3, 3], (60, 1))
        hits, index, _ = mesh.ray.intersects_location(origins, rays, multiple_hits=False)
        _, z = geometry.project(torch.tensor(hits), K, geometry.invert_pose(pose))
        assert f.depth is not None
        ours = f.depth[rows, columns][index]
        close = np.abs(ours - z.numpy()) < 0.002
        assert len(index) == 60 and close.mean() > 0.98  # a ray may pass an edge on either side


def test_poses_and_steps(frames: list[Frame]) -> None:
    poses = np.stack([f.world_T_cam for f in frames])
    assert geometry.is_valid_pose(torch.tensor(poses), tolerance=1e-9).all()
    assert ((poses[:, 2, 3] >= 1.3) & (poses[:, 2, 3] <= 1.7)).all()
    right_up = poses[:, 2, 0]
    assert np.abs(right_up).max() < 0.25, "hardly any roll"
    for a, b in pairwise(poses):
        relative = np.linalg.inv(a) @ b
        turn = np.sqrt(2 * (1 - min(3.0, np.trace(relative[:3, :3])) / 3))
        assert 0.09 < np.hypot(turn, np.linalg.norm(relative[:3, 3])) < 0.16
    spread = np.ptp(poses[:, :2, 3], axis=0)
    assert spread.max() > 0.8, "a walk, not a turn on the spot"


def test_camera_keeps_clear_of_everything(frames: list[Frame], mesh: trimesh.Trimesh) -> None:
    centres = np.stack([f.world_T_cam[:3, 3] for f in frames])
    sphere = trimesh.creation.icosphere(subdivisions=3).vertices
    origins = np.repeat(centres, len(sphere), axis=0)
    rays = np.tile(sphere, (len(centres), 1))
    hits, index, faces = mesh.ray.intersects_location(origins, rays, multiple_hits=False)
    assert len(index) == len(rays), "inside the closed room"
    assert np.linalg.norm(hits - origins[index], axis=1).min() > 0.34
    outward = np.einsum("ij,ij->i", mesh.face_normals[faces], rays[index])
    assert (outward < 0).mean() > 0.995, "sees front sides: inside no furniture"


def test_colours_agree_between_views(frames: list[Frame]) -> None:
    """A point seen from two places keeps its colour: poses, depth and textures fit together."""
    correlations = []
    for a, b in zip(frames[:-4:7], frames[4::7], strict=False):
        assert a.depth is not None and b.depth is not None
        K = torch.tensor(a.K)
        points = geometry.pixel_directions(K, (160, 120)).reshape(-1, 3)
        points = points * torch.tensor(a.depth.reshape(-1, 1).astype(float))
        world = geometry.transform(torch.tensor(a.world_T_cam), points)
        cam_T_world = geometry.invert_pose(torch.tensor(b.world_T_cam))
        uv, z = geometry.project(world, K, cam_T_world)
        seen = geometry.in_view(uv, z, (160, 120), 0.1, 10).numpy()
        u, v = uv.numpy().round().astype(int).clip(0, [159, 119]).T
        seen &= np.abs(b.depth[v, u] - z.numpy()) < 0.01
        if seen.sum() < 1500:
            continue
        left = a.image.reshape(-1, 3)[seen].astype(float)
        right = b.image[v, u][seen].astype(float)
        correlations.append(np.corrcoef(left.ravel(), right.ravel())[0, 1])
    assert len(correlations) >= 3
    assert np.median(correlations) > 0.85


@pytest.fixture(scope="module")
def rooms() -> list[Room]:
    return [make_room(number) for number in range(20, 24)]


def test_furnished_with_variety(rooms: list[Room]) -> None:
    assert min(len(room.placed) for room in rooms) >= 4
    assert len({p.name for room in rooms for p in room.placed}) >= 8
    assert len({room.plan.height for room in rooms}) == len(rooms)


@pytest.mark.parametrize("number", range(4))
def test_nothing_intersects(rooms: list[Room], number: int) -> None:
    room = rooms[number]
    for i, a in enumerate(room.placed):
        assert room.plan.inside(a.corners).all(), a.name
        for b in room.placed[:i]:
            assert not overlap(a.corners, b.corners, 0.0), (a.name, b.name)
    mesh = room.geometry.mesh()
    agree = np.einsum("ij,ij->i", mesh.face_normals, room.geometry.normals)
    assert agree.min() > 0.999, "shading uses the triangles' own normals"
    low, high = mesh.bounds
    assert abs(low[2]) < 1e-9 and 2.4 <= high[2] <= 3.0
    width, depth = np.max([r[2:] for r in room.plan.rects], axis=0)
    assert 3.2 <= width <= 6 and 3 <= depth <= 5
