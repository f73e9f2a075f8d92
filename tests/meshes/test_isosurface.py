"""Marching cubes of partly known grids, on spheres and planes."""

import itertools

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, strategies as st
from torch import Tensor

from tf_lab.geometry import VoxelGrid
from tf_lab.meshes.isosurface import mesh_of

CENTER = torch.tensor([0.513, 0.427, 0.391])
RADIUS = 0.3
GRID = VoxelGrid((-0.1, 0.0, -0.02), 0.02, (60, 44, 42))


def ball(grid: VoxelGrid = GRID) -> Tensor:
    """A field greater than zero inside a ball."""
    return RADIUS - (grid.centers() - CENTER).norm(dim=-1)


def everywhere(grid: VoxelGrid = GRID) -> Tensor:
    return torch.ones(grid.shape, dtype=torch.bool)


def cells_of(mesh: trimesh.Trimesh, grid: VoxelGrid) -> np.ndarray:
    """The lower corners of the cells that the faces lie in: int [F, 3]."""
    centers = torch.tensor(mesh.triangles_center, dtype=torch.float32)
    return grid.to_index(centers).floor().long().numpy()


def test_a_sphere() -> None:
    mesh = mesh_of(ball(), everywhere(), GRID)
    radius = np.linalg.norm(mesh.vertices - CENTER.numpy(), axis=1)
    np.testing.assert_allclose(radius, RADIUS, atol=1e-3)
    outward = mesh.triangles_center - CENTER.numpy()
    assert ((mesh.face_normals * outward).sum(1) > 0).all()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.01)


def test_another_level() -> None:
    mesh = mesh_of(ball(), everywhere(), GRID, level=0.1)
    radius = np.linalg.norm(mesh.vertices - CENTER.numpy(), axis=1)
    np.testing.assert_allclose(radius, RADIUS - 0.1, atol=1e-3)


@pytest.mark.parametrize("value", [-1.0, 0.0, 1.0])
def test_a_constant_field_has_no_surface(value: float) -> None:
    grid = VoxelGrid((0, 0, 0), 0.1, (6, 6, 6))
    for active in (everywhere(grid), torch.zeros(6, 6, 6, dtype=torch.bool)):
        assert len(mesh_of(torch.full((6, 6, 6), value), active, grid).faces) == 0


@given(seed=st.integers(0, 1000), solid=st.booleans())
def test_the_boundary_of_the_mask_is_no_surface(seed: int, solid: bool) -> None:
    grid = VoxelGrid((0, 0, 0), 0.1, (7, 8, 6))
    generator = torch.Generator().manual_seed(seed)
    active = torch.rand(grid.shape, generator=generator) < 0.8
    field = torch.full(grid.shape, 1.0 if solid else -1.0)
    # whatever stands in inactive voxels
    field[~active] = torch.randn(int((~active).sum()), generator=generator)
    assert len(mesh_of(field, active, grid).faces) == 0


@given(seed=st.integers(0, 1000), share=st.floats(0.6, 1.0))
def test_faces_are_exactly_those_of_whole_cells(seed: int, share: float) -> None:
    """Against the mesh of the whole field, of which the other cells' faces are taken away."""
    grid = VoxelGrid((0.0, 0.0, 0.0), 1.0, (7, 6, 8))
    generator = torch.Generator().manual_seed(seed)
    # no value near the level: no face so small that rounding tells its cell
    field = (torch.rand(grid.shape, generator=generator) + 0.2) * torch.where(
        torch.rand(grid.shape, generator=generator) < 0.5, -1.0, 1.0
    )
    active = torch.rand(grid.shape, generator=generator) < share
    whole = np.zeros([n - 1 for n in grid.shape], bool)
    for i, j, k in np.ndindex(*whole.shape):
        whole[i, j, k] = all(
            active[i + a, j + b, k + c] for a, b, c in itertools.product((0, 1), repeat=3)
        )
    reference = mesh_of(field, everywhere(grid), grid)
    kept = whole[tuple(cells_of(reference, grid).T)]
    found = mesh_of(torch.where(active, field, -field), active, grid)

    def sorted_centers(centers: np.ndarray) -> np.ndarray:
        return centers[np.lexsort(centers.round(4).T)]

    assert len(found.faces) == kept.sum()
    np.testing.assert_allclose(
        sorted_centers(np.asarray(found.triangles_center).reshape(-1, 3)),
        sorted_centers(reference.triangles_center[kept]),
        atol=1e-3,
    )


def test_half_a_sphere() -> None:
    half = GRID.centers()[..., 0] < CENTER[0]
    mesh = mesh_of(ball(), half, GRID)
    radius = np.linalg.norm(mesh.vertices - CENTER.numpy(), axis=1)
    np.testing.assert_allclose(radius, RADIUS, atol=1e-3)
    assert mesh.vertices[:, 0].max() < CENTER[0]
    assert mesh.area == pytest.approx(2 * np.pi * RADIUS**2, rel=0.06)


def test_a_slab_one_voxel_thin_has_no_cell() -> None:
    active = torch.zeros(GRID.shape, dtype=torch.bool)
    active[:, :, 20] = True
    assert len(mesh_of(ball(), active, GRID).faces) == 0
    thin = VoxelGrid((0, 0, 0), 0.1, (1, 5, 5))
    assert len(mesh_of(torch.randn(1, 5, 5), everywhere(thin), thin).faces) == 0
