"""Meshing by chunk: known shapes across chunk borders, without seams."""

import numpy as np
import pytest
import torch
from torch import Tensor

from helpers.online.dense import extract
from helpers.online.scenes import Factory, assert_same_surface, surface_of
from tf_lab.geometry import VoxelGrid

CENTER, RADIUS = torch.tensor([0.12, -0.21, 1.57]), 1.1  # in eight chunks
GRID = VoxelGrid((-1.2, -1.5, 0.3), 0.1, (27, 27, 27))


def ball(points: Tensor) -> Tensor:
    return 10 * (RADIUS - (points - CENTER).norm(dim=-1))


def shell() -> Tensor:
    """The voxels near the ball's surface."""
    return ball(GRID.centers()).abs() < 2


@pytest.mark.parametrize("n", [1, 2, 4])
def test_a_ball_is_whole(tiny_network: Factory, n: int) -> None:
    r = surface_of(ball, shell(), GRID, tiny_network(), n)
    assert len(r.surface.parts) == 8
    mesh = r.surface.assemble(None)
    assert mesh.is_watertight
    assert mesh.body_count == 1
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    radius = np.linalg.norm(mesh.vertices - CENTER.numpy(), axis=1)
    np.testing.assert_allclose(radius, RADIUS, atol=2e-3)
    assert ((mesh.triangles_center - CENTER.numpy()) * mesh.face_normals).sum(1).min() > 0
    assert_same_surface(mesh, extract(ball, GRID, shell(), 0.1 / n))


@pytest.mark.parametrize("n", [1, 3])
def test_noise_fits_too(tiny_network: Factory, n: int) -> None:
    """Ambiguous cells at the borders of chunks are resolved alike on both sides."""

    def noise(points: Tensor) -> Tensor:
        cell = (points / (0.1 / n)).floor().double()
        wave = (cell @ torch.tensor([12.9898, 78.233, 37.719], dtype=torch.float64)).sin()
        return (wave * 43758.5453 % 1 - 0.5).float()

    active = torch.ones(GRID.shape, dtype=torch.bool)
    mesh = surface_of(noise, active, GRID, tiny_network(), n).surface.assemble(None)
    assert_same_surface(mesh, extract(noise, GRID, active, 0.1 / n))


def test_a_changed_block_changes_the_chunks_that_read_it(tiny_network: Factory) -> None:
    """The chunks whose samples a block holds, and those whose last layer of cells ends in it."""
    r = surface_of(ball, shell(), GRID, tiny_network(), 1)
    for block in range(0, len(r.fine.blocks), 7):
        r.surface.touch(torch.tensor([block]))
        low = r.fine.blocks.coords[block].numpy() * 3  # its first fine voxel
        voxels = low + np.argwhere(np.ones((3, 3, 3)))
        expected = set()
        for corner in np.argwhere(np.ones((2, 2, 2))):
            expected |= {tuple(c) for c in ((voxels - corner) // 15).tolist()}
        assert r.surface.dirty == expected
        r.surface.dirty.clear()
