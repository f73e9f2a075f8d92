"""Colours of a mesh's vertices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import trimesh
from torch import Tensor

from tf_lab.geometry import invert_pose, project, sample_maps


def color_vertices(
    mesh: trimesh.Trimesh,
    images: Sequence[Tensor],
    K: Tensor,
    world_T_cam: Tensor,
    tolerance: float = 0.05,
    occluders: np.ndarray | None = None,
) -> None:
    """Give the vertices the mean colour of the images that see them, in place.

    Args:
        mesh: a mesh with faces, metres.
        images: uint8 [3, H, W], N of them.
        K: [N, 3, 3].
        world_T_cam: [N, 4, 4].
        tolerance: a vertex this much (metres) behind the surface that an image sees is hidden.
        occluders: [P, 3], metres: points of other surfaces that may hide the mesh, densely.
    """
    vertices = torch.from_numpy(np.asarray(mesh.vertices)).float()
    others = np.empty((0, 3)) if occluders is None else occluders
    points = torch.cat([vertices, torch.from_numpy(others).float()])
    total, weight = torch.zeros(len(vertices), 3), torch.zeros(len(vertices), 1)
    for image, k, pose in zip(images, K, world_T_cam, strict=True):
        size = (image.shape[2], image.shape[1])
        uv, depth = project(points, k, invert_pose(pose))
        u, v = uv.round().long().unbind(-1)
        seen = (depth > 0.1) & (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])
        index = seen.nonzero().squeeze(1)
        nearest = _depth_of_points(u[index], v[index], depth[index], size)
        index = index[(depth[index] < nearest + tolerance) & (index < len(vertices))]
        color = sample_maps(image[None].float(), uv[None, index], size)[0]
        w = 1 / depth[index, None].clamp(min=0.3) ** 2  # near views are sharper
        total[index] += w * color
        weight[index] += w
    rgb = torch.where(weight > 0, total / weight.clamp(min=1e-9), torch.full_like(total, 128.0))
    rgba = torch.cat([rgb.round().clamp(0, 255), torch.full_like(weight, 255)], 1)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=rgba.byte().numpy())


def _depth_of_points(u: Tensor, v: Tensor, depth: Tensor, size: tuple[int, int]) -> Tensor:
    """The nearest depth among the points around each point's pixel: [P].

    Splats the points into a quarter-resolution depth buffer, dense enough for 2 cm meshes.
    """
    width = size[0] // 4 + 1
    cell = (v // 4) * width + u // 4
    buffer = torch.full((width * (size[1] // 4 + 1),), torch.inf)
    buffer.scatter_reduce_(0, cell, depth, reduce="amin")
    return buffer[cell]
