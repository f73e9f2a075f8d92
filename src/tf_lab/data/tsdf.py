"""Volumetric fusion of depth maps into a truncated signed distance field (Curless & Levoy 1996)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import torch
import trimesh
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.geometry import VoxelGrid, invert_pose, pixel_directions, project, transform
from tf_lab.isosurface import mesh_of


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
    depths: Iterable[Tensor], K: Tensor, world_T_cam: Tensor, margin: float, stride: int = 4
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
    depths: Iterable[Tensor],
    K: Tensor,
    world_T_cam: Tensor,
    grid: VoxelGrid,
    truncation: float,
    far: float,
) -> TSDF:
    """Fuse depth maps [h, w] (camera z, metres; 0 unknown) with equal weights.

    Args:
        depths: N depth maps.
        K: [N, 3, 3] intrinsics of the depth maps.
        world_T_cam: [N, 4, 4].
        grid: where to fuse.
        truncation: metres.
        far: readings beyond this depth (metres) are not used.
    """
    distance = torch.zeros(grid.shape)
    weight = torch.zeros(grid.shape)
    for i, depth in enumerate(depths):
        depth = torch.where(depth > far, torch.zeros_like(depth), depth)
        block = _frustum_block(grid, depth, K[i], world_T_cam[i], truncation)
        if block is not None:
            _integrate(distance[block], weight[block], _centers(grid, block), depth,
                       K[i], invert_pose(world_T_cam[i]), truncation)  # fmt: skip
    return TSDF(grid, distance / weight.clamp(min=1), weight, truncation)


def extract_mesh(tsdf: TSDF) -> trimesh.Trimesh:
    """The zero level of the field, between observed voxels only; possibly empty."""
    return mesh_of(-tsdf.distance, tsdf.weight > 0, tsdf.grid)


def _frustum_block(
    grid: VoxelGrid, depth: Tensor, K: Tensor, world_T_cam: Tensor, truncation: float
) -> tuple[slice, slice, slice] | None:
    """The part of the grid that the frame can reach, as slices; None if there is none."""
    reach = float(depth.max()) + truncation
    if reach <= truncation:
        return None
    height, width = depth.shape
    directions = pixel_directions(K, (width, height))[[0, 0, -1, -1], [0, -1, 0, -1]]
    corners = torch.cat([world_T_cam[None, :3, 3], transform(world_T_cam, directions * reach)])
    index = grid.to_index(corners)
    low = (index.amin(0).floor().long() - 1).clamp(min=0).tolist()
    high = (index.amax(0).ceil().long() + 2).tolist()
    high = [min(h, n) for h, n in zip(high, grid.shape, strict=True)]
    if any(a >= b for a, b in zip(low, high, strict=True)):
        return None
    return (slice(low[0], high[0]), slice(low[1], high[1]), slice(low[2], high[2]))


def _centers(grid: VoxelGrid, block: tuple[slice, slice, slice]) -> Tensor:
    axes = [
        o + (torch.arange(s.start, s.stop) + 0.5) * grid.voxel
        for o, s in zip(grid.origin, block, strict=True)
    ]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)


def _integrate(
    distance: Tensor,
    weight: Tensor,
    centers: Tensor,
    depth: Tensor,
    K: Tensor,
    cam_T_world: Tensor,
    truncation: float,
) -> None:
    """Add one frame to the blocks ``distance`` (a running sum) and ``weight`` [x, y, z]."""
    height, width = depth.shape
    uv, z = project(centers.reshape(-1, 3), K, cam_T_world)
    pixel = uv.round()
    inside = (
        (pixel[:, 0] >= 0)
        & (pixel[:, 0] < width)
        & (pixel[:, 1] >= 0)
        & (pixel[:, 1] < height)
        & (z > 0)
    )
    index = inside.nonzero().squeeze(1)
    column, row = pixel[index].long().unbind(-1)
    reading = depth[row, column]
    signed = reading - z[index]
    keep = (reading > 0) & (signed > -truncation)
    index, signed = index[keep], signed[keep].clamp(max=truncation)
    flat_d, flat_w = distance.reshape(-1), weight.reshape(-1)
    flat_d[index] += signed
    flat_w[index] += 1
    if not distance.is_contiguous():  # reshape copied: write back
        distance.copy_(flat_d.view_as(distance))
        weight.copy_(flat_w.view_as(weight))
