"""Decoding, meshing and colouring of known shapes."""

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

from helpers.online.dense import crossing_voxels, extract
from tf_lab.errors import TFLabError
from tf_lab.geometry import VoxelGrid
from tf_lab.meshes.colors import color_vertices

CENTER, RADIUS = torch.tensor([0.52, 0.61, 0.47]), 0.3
GRID = VoxelGrid((0.0, 0.0, 0.0), 0.1, (11, 12, 10))


def ball(points: Tensor) -> Tensor:
    """Logits: linear in the distance to a sphere, so that interpolation is all but exact."""
    return 10 * (RADIUS - (points - CENTER).norm(dim=-1))


def active() -> Tensor:
    return torch.ones(GRID.shape, dtype=torch.bool)


@pytest.mark.parametrize(("resolution", "tolerance"), [(0.02, 1e-3), (0.05, 3e-3), (0.1, 9e-3)])
def test_a_sphere(resolution: float, tolerance: float) -> None:
    mesh = extract(ball, GRID, active(), resolution)
    radius = np.linalg.norm(mesh.vertices - CENTER.numpy(), axis=1)
    np.testing.assert_allclose(radius, RADIUS, atol=tolerance)
    assert ((mesh.triangles_center - CENTER.numpy()) * mesh.face_normals).sum(1).min() > 0
    assert mesh.is_watertight


def test_a_plane_at_an_angle() -> None:
    """Values are those of the cells' own centres: a plane comes out exactly."""
    normal = torch.tensor([1.0, 2.0, 3.0]) / 14**0.5
    mesh = extract(lambda p: 0.8 - p @ normal, GRID, active(), 0.05)
    np.testing.assert_allclose(mesh.vertices @ normal.numpy(), 0.8, atol=1e-5)
    assert (mesh.face_normals @ normal.numpy()).min() > 0.999  # towards the free side


def test_batches_do_not_matter() -> None:
    whole = extract(ball, GRID, active(), 0.05)
    parts = extract(ball, GRID, active(), 0.05, batch=77)
    assert np.array_equal(whole.vertices, parts.vertices)
    assert np.array_equal(whole.faces, parts.faces)


def test_only_active_voxels_are_decoded_and_meshed() -> None:
    some = torch.rand(GRID.shape, generator=torch.Generator().manual_seed(0)) < 0.7
    asked: list[Tensor] = []

    def decode(points: Tensor) -> Tensor:
        asked.append(points)
        return ball(points)

    mesh = extract(decode, GRID, some, 0.05)
    points = torch.cat(asked)
    assert len(points) == 8 * some.sum()
    assert some[tuple((points / 0.1).long().T)].all()
    whole = extract(ball, GRID, active(), 0.05)
    # every face of the part is one of the whole, with all that it touches active
    known = {tuple(c) for c in np.round(whole.triangles_center, 5).tolist()}
    assert 0 < len(mesh.faces) < len(whole.faces)
    assert {tuple(c) for c in np.round(mesh.triangles_center, 5).tolist()} <= known
    voxel = torch.from_numpy(mesh.triangles_center / 0.1).long()
    assert some[tuple(voxel.T)].all()


def test_a_solid_field_gives_no_faces_at_the_boundary() -> None:
    some = torch.rand(GRID.shape, generator=torch.Generator().manual_seed(0)) < 0.5
    assert len(extract(lambda p: torch.full((len(p),), 3.0), GRID, some, 0.05).faces) == 0
    assert len(extract(lambda p: torch.full((len(p),), -3.0), GRID, some, 0.05).faces) == 0
    assert len(extract(ball, GRID, ~active(), 0.05).faces) == 0


@pytest.mark.parametrize("resolution", [0.03, 0.2, 0.07, -0.02, 0.0])
def test_resolutions_that_do_not_divide_the_voxel(resolution: float) -> None:
    with pytest.raises(TFLabError, match="resolution"):
        extract(ball, GRID, active(), resolution)


def test_voxels_around_a_change_of_occupancy() -> None:
    some = torch.rand(GRID.shape, generator=torch.Generator().manual_seed(1)) < 0.8
    solid = ball(GRID.centers()) > 0
    expected = torch.zeros(GRID.shape, dtype=torch.bool)
    for i, j, k in some.nonzero().tolist():
        block = tuple(slice(max(0, x - 1), x + 2) for x in (i, j, k))
        near = solid[block][some[block]]
        expected[i, j, k] = near.any() and not near.all()
    assert torch.equal(crossing_voxels(ball, GRID, some), expected)
    assert 0 < expected.sum() < some.sum()


def wall(x: float, half: float, step: float = 0.02) -> trimesh.Trimesh:
    """A square in the plane x, a vertex every ``step`` metres."""
    n = round(2 * half / step) + 1
    side = np.linspace(-half, half, n)
    y, z = np.meshgrid(side, side, indexing="ij")
    vertices = np.stack([np.full_like(y, x), y, z], -1).reshape(-1, 3)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = (j.reshape(-1) for j in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    return trimesh.Trimesh(
        vertices, np.concatenate([np.c_[a, b, c], np.c_[a, c, d]]), process=False
    )


def along_x(at: float = 0.0) -> Tensor:
    """A camera at (at, 0, 0) that looks along x: right is -y, down is -z."""
    pose = torch.eye(4)
    pose[:3, :3] = torch.tensor([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    pose[0, 3] = at
    return pose


K = torch.tensor([[100.0, 0, 79.5], [0, 100.0, 59.5], [0, 0, 1]])


def uniform(r: int, g: int, b: int) -> Tensor:
    return torch.tensor([r, g, b], dtype=torch.uint8).view(3, 1, 1).expand(3, 120, 160)


def paint(mesh: trimesh.Trimesh, images: list[Tensor], poses: list[Tensor]) -> np.ndarray:
    color_vertices(mesh, images, K.expand(len(images), 3, 3), torch.stack(poses))
    assert isinstance(mesh.visual, trimesh.visual.ColorVisuals)
    colors = np.asarray(mesh.visual.vertex_colors).astype(int)
    assert colors.shape == (len(mesh.vertices), 4)
    assert (colors[:, 3] == 255).all()
    return colors[:, :3]


@pytest.mark.parametrize("side", ["right", "below"])
def test_colours_lie_where_they_were_seen(side: str) -> None:
    image = uniform(200, 10, 30).clone()
    if side == "right":
        image[:, :, 80:] = uniform(0, 250, 60)[:, :, 80:]
    else:
        image[:, 60:] = uniform(0, 250, 60)[:, 60:]
    mesh = wall(2.0, 0.9)
    colors = paint(mesh, [image], [along_x()])
    position = mesh.vertices[:, 1 if side == "right" else 2]  # +y is left, +z is up
    assert (colors[position > 0.03] == [200, 10, 30]).all()
    assert (colors[position < -0.03] == [0, 250, 60]).all()


def test_views_are_averaged_and_near_ones_count_more() -> None:
    mesh = wall(2.0, 0.3)
    colors = paint(mesh, [uniform(240, 0, 0), uniform(0, 240, 0)], [along_x(), along_x()])
    assert (colors == [120, 120, 0]).all()
    colors = paint(mesh, [uniform(240, 0, 0), uniform(0, 240, 0)], [along_x(), along_x(1.0)])
    assert (colors[:, 1] > colors[:, 0]).all()
    assert (np.abs(colors.sum(1) - 240) <= 1).all()


def test_no_colour_passes_through_an_occluder() -> None:
    """A wall behind another: the hidden part keeps grey, the rest is painted."""
    front, back = wall(1.0, 0.3), wall(2.0, 0.9)
    mesh = trimesh.util.concatenate([front, back])
    assert isinstance(mesh, trimesh.Trimesh)
    colors = paint(mesh, [uniform(9, 99, 199)], [along_x()])
    on_front = mesh.vertices[:, 0] < 1.5
    shadow = np.abs(mesh.vertices[:, 1:]).max(1)
    assert (colors[on_front] == [9, 99, 199]).all()
    assert (colors[~on_front & (shadow < 0.52)] == 128).all()  # the shadow reaches to 0.6
    assert (colors[~on_front & (shadow > 0.72)] == [9, 99, 199]).all()


def test_a_floor_seen_from_low_down_has_no_stripes() -> None:
    """One image, 17 to 30 degrees above the floor: none of it hides what lies behind."""
    floor = wall(0, 1.7)
    _, along, across = floor.vertices.T
    floor.vertices = np.c_[2.5 + 0.5 * along, 0.3 * across, np.full(len(along), -1)]
    colors = paint(floor, [uniform(9, 99, 199)], [along_x()])
    x, y, z = floor.vertices.T
    seen = (59.5 - 100 * z / x < 118) & (np.abs(100 * y / x) < 79)
    assert seen.sum() > 1000
    assert (colors[seen] == [9, 99, 199]).all()


@pytest.mark.parametrize("at", [2.5, -500.0])
def test_what_no_image_sees_is_grey(at: float) -> None:
    mesh = wall(2.0, 0.3)  # behind the camera; too far beside the image
    poses = [along_x(at)]
    if at < 0:
        poses[0][1, 3] = 1000.0
    assert (paint(mesh, [uniform(1, 2, 3)], poses) == 128).all()
