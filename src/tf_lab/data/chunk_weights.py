"""Where in a scene to train: fewer chunks in free space, more with furniture (paper, Sec. 3.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from tf_lab.geometry import CHUNK, COARSE, FINE, VoxelGrid

EMPTY_SHARE = 0.2


@dataclass(frozen=True)
class Structure:
    """Points [P, 3] (metres) of a labelled surface, and whether each is floor or wall: bool [P]."""

    points: np.ndarray
    is_structure: np.ndarray


def chunk_candidates(
    mesh: trimesh.Trimesh,
    grid: VoxelGrid,
    structure: Structure | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Chunk centres and their sampling weights: fewer in free space, more with furniture.

    Weights: 1 with structure only, rising to 3 with the share of furniture.
    Chunks without surface, in the scene or up to a chunk beyond it (where frusta reach at test
    time), get little: 0.15, and together at most EMPTY_SHARE of all others.

    Returns:
        centers float32 [M, 3] in metres, weight float32 [M].
    """
    vertices = np.asarray(mesh.vertices)
    lower, upper = vertices.min(0), vertices.max(0)
    furniture = (
        _furniture_by_shape(vertices) if structure is None else ~_labels(vertices, structure)
    )

    half = CHUNK / 2
    axes = [np.arange(a - CHUNK, b + CHUNK, COARSE) for a, b in zip(lower, upper, strict=True)]
    centers = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    # counts of vertices in the box around each centre, by the max norm
    everything = cKDTree(vertices).query_ball_point(
        centers, half, p=np.inf, return_length=True, workers=1
    )
    if furniture.any():
        things = cKDTree(vertices[furniture]).query_ball_point(
            centers, half, p=np.inf, return_length=True, workers=1
        )
    else:
        things = np.zeros(len(centers), int)
    some = (CHUNK / grid.voxel) ** 2 * 0.1  # a tenth of one plane through the chunk
    share = np.minimum(things / (2 * some), 1.0)
    weight = 1.0 + 2.0 * share
    empty = everything < some
    if not empty.all():
        weight[empty] = min(EMPTY_SHARE * weight[~empty].sum() / max(1, empty.sum()), 0.15)
    return centers.astype(np.float32), weight.astype(np.float32)


def _furniture_by_shape(vertices: np.ndarray) -> np.ndarray:
    """Without labels: bool [V], what is neither wall nor floor nor ceiling.

    Surface in columns that are covered over most of the scene's height is wall, surface near the
    lowest or highest level is floor or ceiling.
    """
    lower = vertices.min(0)
    cell = np.floor((vertices[:, :2] - lower[:2]) / FINE).astype(int)
    level = np.floor((vertices[:, 2] - lower[2]) / FINE).astype(int)
    shape = (*(cell.max(0) + 1), level.max() + 1)
    occupied = np.zeros(shape, bool)
    occupied[cell[:, 0], cell[:, 1], level] = True
    wall = occupied.sum(2) > 0.5 * shape[2]
    floor, ceiling = np.quantile(vertices[:, 2], [0.02, 0.98])
    flat = (vertices[:, 2] < floor + 0.15) | (vertices[:, 2] > ceiling - 0.15)
    return ~wall[cell[:, 0], cell[:, 1]] & ~flat


def _labels(vertices: np.ndarray, structure: Structure) -> np.ndarray:
    """Bool [V]: the label of the nearest labelled point."""
    _, nearest = cKDTree(structure.points).query(vertices)
    return structure.is_structure[nearest]
