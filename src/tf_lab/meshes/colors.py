"""Colours of a mesh's vertices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import trimesh
from torch import Tensor

from tf_lab.geometry import invert_pose, project, sample_maps
from tf_lab.geometry.frustum import frustum_planes
from tf_lab.geometry.poses import linear_map

CELL = 4  # pixels, of the depth buffer
BEHIND = 0.05  # metres; a vertex further behind the surface that an image sees is hidden
PART = 1.0  # metres; of what lies in such a cell beside a frustum no point is looked at
FAR = 1e4  # metres
STEEPEST = 0.5  # metres of depth that a surface may have in one of its cells


def color_vertices(
    mesh: trimesh.Trimesh,
    images: Sequence[Tensor],
    K: Tensor,
    world_T_cam: Tensor,
    occluders: np.ndarray | None = None,
) -> None:
    """Give the vertices the mean colour of the images that see them, in place.

    Args:
        mesh: a mesh with faces, metres.
        images: uint8 [3, H, W], N of them.
        K: [N, 3, 3].
        world_T_cam: [N, 4, 4].
        occluders: [P, 3], metres: points of other surfaces that may hide the mesh, densely.
    """
    vertices = torch.from_numpy(np.asarray(mesh.vertices)).float()
    normals = torch.from_numpy(np.array(mesh.vertex_normals)).float()
    others = np.empty((0, 3)) if occluders is None else occluders
    points = torch.cat([vertices, torch.from_numpy(others).float()])
    total, weight = torch.zeros(len(vertices), 3), torch.zeros(len(vertices), 1)
    centers, part = _parts(points)
    for image, k, pose in zip(images, K, world_T_cam, strict=True):
        size = (image.shape[2], image.shape[1])
        planes = frustum_planes(k, pose, size, 0.0, FAR)
        inside = linear_map(planes[:, :3], centers) + planes[:, 3] > -PART * 0.87  # half a diagonal
        index = inside.all(1)[part].nonzero().squeeze(1)
        uv, depth = project(points[index], k, invert_pose(pose))
        u, v = uv.round().long().unbind(-1)
        seen = (depth > 0.1) & (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])
        seen = seen.nonzero().squeeze(1)
        index, depth = index[seen], depth[seen]
        nearest = _depth_of_points(u[seen], v[seen], depth, size)
        own = int((index < len(vertices)).sum())  # the others come after them
        index, depth = index[:own], depth[:own]
        reach = BEHIND + _depth_in_cell(vertices[index], normals[index], k, pose)
        front = (depth < nearest[:own] + reach).nonzero().squeeze(1)
        index, depth = index[front], depth[front]
        color = sample_maps(image[None].float(), uv[None, seen[front]], size)[0]
        w = 1 / depth[:, None].clamp(min=0.3) ** 2  # near views are sharper
        total[index] += w * color
        weight[index] += w
    rgb = torch.where(weight > 0, total / weight.clamp(min=1e-9), torch.full_like(total, 128.0))
    rgba = torch.cat([rgb.round().clamp(0, 255), torch.full_like(weight, 255)], 1)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=rgba.byte().numpy())


def _parts(points: Tensor) -> tuple[Tensor, Tensor]:
    """Centres [N, 3] of the cells of `PART` metres that hold points [P, 3], and whose each is."""
    if not len(points):
        return points, torch.empty(0, dtype=torch.int64)
    place = (points / PART).floor().long()
    first = place.amin(0)
    place -= first
    _, y, z = (place.amax(0) + 1).tolist()
    number, part = torch.unique(
        (place[:, 0] * y + place[:, 1]) * z + place[:, 2], return_inverse=True
    )
    cells = torch.stack([number // (y * z), number // z % y, number % z], 1)
    return (cells + first + 0.5) * PART, part


def _depth_of_points(u: Tensor, v: Tensor, depth: Tensor, size: tuple[int, int]) -> Tensor:
    """The nearest depth among the points around each point's pixel: [P].

    Splats the points into a depth buffer so coarse that it has no holes for 2 cm meshes.
    """
    width = size[0] // CELL + 1
    cell = (v // CELL) * width + u // CELL
    buffer = torch.full((width * (size[1] // CELL + 1),), torch.inf)
    buffer.scatter_reduce_(0, cell, depth, reduce="amin")
    return buffer[cell]


def _depth_in_cell(points: Tensor, normals: Tensor, K: Tensor, world_T_cam: Tensor) -> Tensor:
    """How far apart in depth a surface is within a cell of the depth buffer: [P], metres.

    A floor seen from low down is so steep that its far part would count as hidden by its near one.
    """
    rays = points - world_T_cam[:3, 3]
    distance = rays.norm(dim=1)
    cosine = (rays * normals).sum(1).abs() / distance.clamp(min=1e-6)
    slope = (1 - cosine**2).clamp(min=0).sqrt() / cosine.clamp(min=0.05)
    return (CELL * distance / K[0, 0] * slope).clamp(max=STEEPEST)
