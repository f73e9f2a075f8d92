"""Marching cubes on voxel grids that are known only in part."""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from skimage.measure import marching_cubes
from torch import Tensor

from tf_lab.geometry import VoxelGrid


def mesh_of(field: Tensor, active: Tensor, grid: VoxelGrid, level: float = 0.0) -> trimesh.Trimesh:
    """Marching cubes (Lorensen & Cline 1987) in the cells whose 8 corners are all active.

    Args:
        field: float [X, Y, Z], greater inside (solid). Normals point towards lower values.
        active: bool [X, Y, Z].
        grid: the voxels whose centres carry the field.
        level: the surface's value.

    Returns:
        A mesh in metres; without vertices or faces if there is no surface.
    """
    whole = active[:-1, :-1, :-1].clone()  # cells by their lower corner
    for dx, dy, dz in np.ndindex(2, 2, 2):
        x, y, z = (slice(d, n - 1 + d) for d, n in zip((dx, dy, dz), active.shape, strict=True))
        whole &= active[x, y, z]
    # scikit-image looks at one corner of a cell only, the upper one
    mask = torch.zeros_like(active)
    mask[1:, 1:, 1:] = whole
    values = torch.where(active, field, torch.full_like(field, level - 1.0))
    inside = values[active]
    if not mask.any() or inside.min() >= level or inside.max() <= level:
        return trimesh.Trimesh()
    try:
        vertices, faces, _, _ = marching_cubes(
            values.numpy(), level, mask=mask.numpy(), gradient_direction="ascent"
        )
    except (RuntimeError, ValueError):  # "No surface found": all crossings are masked
        return trimesh.Trimesh()
    matrix = grid.world_T_index.numpy()
    vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return trimesh.Trimesh(vertices, faces, process=False)
