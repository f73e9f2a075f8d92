"""The voxels that a camera may see: candidates without any search, however large the scene is."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def frustum_box(
    K: np.ndarray, world_T_cam: np.ndarray, size: tuple[int, int], near: float, far: float
) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner [3] (metres) of the box around a frustum.

    Args:
        K: [3, 3], pixels.
        world_T_cam: [4, 4].
        size: (width, height), pixels.
        near: least camera z, metres.
        far: greatest camera z, metres.
    """
    u, v = np.meshgrid([-0.5, size[0] - 0.5], [-0.5, size[1] - 0.5])
    rays = np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3) @ np.linalg.inv(K).T
    corners = np.concatenate([rays * near, rays * far]) @ world_T_cam[:3, :3].T + world_T_cam[:3, 3]
    return corners.min(0), corners.max(0)


def frustum_planes(
    K: np.ndarray, world_T_cam: np.ndarray, size: tuple[int, int], near: float, far: float
) -> tuple[np.ndarray, np.ndarray]:
    """The six planes of a frustum: inward unit normals n [6, 3] and offsets d [6], metres.

    A point p is in the frustum if all n p + d are at least 0; a ball of radius r around it can only
    touch the frustum if all are at least -r. Arguments as of `frustum_box`.
    """
    width, height = size
    # u >= -0.5 is (K[0] + 0.5 K[2]) c >= 0 for camera-space points c, and so on
    camera = np.stack(
        [
            K[0] + 0.5 * K[2],
            (width - 0.5) * K[2] - K[0],
            K[1] + 0.5 * K[2],
            (height - 0.5) * K[2] - K[1],
            [0, 0, 1],
            [0, 0, -1],
        ]
    ).astype(np.float64)
    camera /= np.linalg.norm(camera, axis=1, keepdims=True)
    normals = camera @ world_T_cam[:3, :3].T
    return normals, np.array([0, 0, 0, 0, -near, far]) - normals @ world_T_cam[:3, 3]


def voxels_in(lower: np.ndarray, upper: np.ndarray, voxel: float, device: torch.device) -> Tensor:
    """Lattice coordinates int64 [P, 3] of all voxels that a box (metres) touches."""
    low = np.floor(lower / voxel - 1e-4).astype(int)
    high = np.floor(upper / voxel + 1e-4).astype(int) + 1
    axes = [torch.arange(int(a), int(b), device=device) for a, b in zip(low, high, strict=True)]
    return torch.cartesian_prod(*axes)
