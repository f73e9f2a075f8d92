"""Volumetric fusion of depth maps into a truncated signed distance field (Curless & Levoy 1996).

A large scene is fused in slabs along x, so that memory is bounded by a budget and not by the scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
import trimesh
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.geometry import VoxelGrid, frustum_corners, invert_pose, pixel_directions, transform
from tf_lab.meshes.isosurface import mesh_of
from tf_lab.meshes.weld import weld

BYTES = 64  # a voxel of a slab while it is fused: the sums, and a frame's temporaries


@dataclass(frozen=True)
class TSDF:
    """A fused field.

    Attributes:
        grid: its voxels.
        distance: float32 [X, Y, Z], signed distance in metres (positive in front of the surface),
            clipped to +- truncation; meaningless where ``weight`` is 0.
        weight: float32 [X, Y, Z], number of frames that observed the voxel, in front of the
            surface or at most the truncation behind it.
        truncation: metres.
    """

    grid: VoxelGrid
    distance: Tensor
    weight: Tensor
    truncation: float


def unproject(depth: Tensor, K: Tensor, world_T_cam: Tensor) -> Tensor:
    """World points [P, 3] of the pixels of a depth map [h, w] (camera z, metres) that are > 0."""
    height, width = depth.shape
    camera = pixel_directions(K, (width, height)) * depth[..., None]
    return transform(world_T_cam, camera[depth > 0])


def bounds_of(
    depths: Sequence[Tensor], K: Tensor, world_T_cam: Tensor, margin: float, stride: int = 4
) -> tuple[Tensor, Tensor]:
    """The box (lower [3], upper [3]) around all depth readings, widened by a margin in metres.

    Raises:
        TFLabError: no frame has a reading.
    """
    lower, upper = torch.full((3,), torch.inf), torch.full((3,), -torch.inf)
    for i, depth in enumerate(depths):
        points = unproject(depth, K[i], world_T_cam[i])[::stride]
        if len(points):
            lower = torch.minimum(lower, points.amin(0))
            upper = torch.maximum(upper, points.amax(0))
    if not torch.isfinite(lower).all():
        raise TFLabError("no depth reading in any frame; the depth maps are empty")
    return lower - margin, upper + margin


def fuse(
    depths: Sequence[Tensor],
    K: Tensor,
    world_T_cam: Tensor,
    grid: VoxelGrid,
    truncation: float,
    far: float,
    rows: tuple[int, int] | None = None,
    device: torch.device | str = "cpu",
) -> TSDF:
    """Fuse depth maps [h, w] (camera z, metres; 0 unknown) with equal weights.

    Args:
        depths: N depth maps of one size; only the first is asked for, and those whose camera may
            see the rows.
        K: [N, 3, 3] intrinsics of the depth maps.
        world_T_cam: [N, 4, 4].
        grid: where to fuse.
        truncation: metres.
        far: readings beyond this depth (metres) are not used.
        rows: first and last (exclusive) index along x, None for all; every voxel gets the same
            value, whatever the rows it is fused with.
        device: where to compute; the result is on the CPU.
    """
    first, last = rows or (0, grid.shape[0])
    shape = (last - first, *grid.shape[1:])
    total, weight = torch.zeros(shape, device=device), torch.zeros(shape, device=device)
    size: tuple[int, int] | None = None  # told by the first
    for i in range(len(depths)):
        camera = K[i], world_T_cam[i]
        if size and _frustum_block(grid, (first, last), *camera, size, far + truncation) is None:
            continue
        depth = depths[i]
        depth = torch.where(depth > far, torch.zeros_like(depth), depth)
        size = (depth.shape[1], depth.shape[0])
        reach = float(depth.max())
        if reach <= 0:
            continue
        block = _frustum_block(grid, (first, last), *camera, size, reach + truncation)
        if block is not None:
            x, y, z = block
            part = (slice(x.start - first, x.stop - first), y, z)
            signed, seen = _measure(grid, block, depth.to(device), *camera, truncation)
            total[part] += signed
            weight[part] += seen
    block_grid = grid.block((first, 0, 0), (last, *grid.shape[1:]))
    return TSDF(block_grid, (total / weight.clamp(min=1)).cpu(), weight.cpu(), truncation)


def slabs(grid: VoxelGrid, memory: int) -> list[tuple[int, int]]:
    """Rows (first, last exclusive) along x that can each be fused within ``memory`` bytes."""
    n, y, z = grid.shape
    step = max(1, memory // (BYTES * y * z) - 1)  # each is fused with the next one's first row
    return [(first, min(first + step, n)) for first in range(0, n, step)]


def fuse_in_slabs(
    depths: Sequence[Tensor],
    K: Tensor,
    world_T_cam: Tensor,
    grid: VoxelGrid,
    truncation: float,
    far: float,
    memory: int = 2**30,
    device: torch.device | str = "cpu",
) -> Iterator[tuple[int, TSDF]]:
    """`fuse` in slabs along x within ``memory`` bytes.

    Yields:
        How many rows are this slab's own, and the slab: those rows and (but for the last) the first
        of the next slab, so that marching cubes leaves no gap between them.
    """
    for first, last in slabs(grid, memory):
        rows = (first, min(last + 1, grid.shape[0]))
        yield last - first, fuse(depths, K, world_T_cam, grid, truncation, far, rows, device)


def extract_mesh(tsdf: TSDF) -> trimesh.Trimesh:
    """The zero level of the field, between observed voxels only; possibly empty."""
    return mesh_of(-tsdf.distance, tsdf.weight > 0, tsdf.grid)


def join(meshes: Sequence[trimesh.Trimesh], tolerance: float = 1e-5) -> trimesh.Trimesh:
    """The meshes of neighbouring slabs as one; vertices closer than ``tolerance`` metres merge."""
    parts = [(mesh.vertices, mesh.faces) for mesh in meshes if len(mesh.faces)]
    return trimesh.Trimesh(*weld(parts, tolerance), process=False) if parts else trimesh.Trimesh()


def _frustum_block(
    grid: VoxelGrid,
    rows: tuple[int, int],
    K: Tensor,
    world_T_cam: Tensor,
    size: tuple[int, int],
    reach: float,
) -> tuple[slice, slice, slice] | None:
    """What of the grid's rows a camera can see up to a depth, as slices; None if nothing."""
    index = grid.to_index(frustum_corners(K, world_T_cam, size, 0.0, reach))
    low = (index.amin(0).floor().long() - 1).clamp(min=0).tolist()
    high = (index.amax(0).ceil().long() + 2).tolist()
    high = [min(h, n) for h, n in zip(high, grid.shape, strict=True)]
    low[0], high[0] = max(low[0], rows[0]), min(high[0], rows[1])
    if any(a >= b for a, b in zip(low, high, strict=True)):
        return None
    return (slice(low[0], high[0]), slice(low[1], high[1]), slice(low[2], high[2]))


def _measure(
    grid: VoxelGrid,
    block: tuple[slice, slice, slice],
    depth: Tensor,
    K: Tensor,
    world_T_cam: Tensor,
    truncation: float,
) -> tuple[Tensor, Tensor]:
    """What one frame says of a block: clipped signed distance [x, y, z] (0 unseen), bool seen.

    The projection is affine in the voxel index before the division, so it is a sum of one vector an
    axis. Sums of three numbers, unlike matrix products, do not depend on the block they are in.
    """
    height, width = depth.shape
    pixels_T_world = K.double() @ invert_pose(world_T_cam.double())[:3]
    # image coordinates as grid_sample wants them: -1 and 1 are the image's borders
    normalise = torch.tensor(
        [[2 / width, 0, 1 / width - 1], [0, 2 / height, 1 / height - 1], [0, 0, 1]],
        dtype=torch.float64,
    )
    rows = normalise @ pixels_T_world
    axes = [
        o + (torch.arange(s.start, s.stop, dtype=torch.float64) + 0.5) * grid.voxel
        for o, s in zip(grid.origin, block, strict=True)
    ]

    def affine(row: Tensor) -> Tensor:
        x, y, z = ((row[d] * axes[d]).float().to(depth.device) for d in range(3))
        return ((x + row[3].float().to(x.device))[:, None] + y)[..., None] + z

    z = affine(rows[2])
    inverse = 1 / z.clamp(min=1e-6)  # behind the camera: far off the image
    where = torch.stack([affine(rows[0]) * inverse, affine(rows[1]) * inverse], -1)
    reading = F.grid_sample(
        depth[None, None], where.view(1, 1, -1, 2), mode="nearest", align_corners=False
    ).view(z.shape)  # 0 off the image
    signed = reading - z
    seen = (reading > 0) & (signed > -truncation)
    return torch.where(seen, signed.clamp(max=truncation), 0.0), seen
