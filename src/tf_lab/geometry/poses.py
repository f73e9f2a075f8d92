"""Rigid transforms."""

from __future__ import annotations

import math

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import ArrayLike
from torch import Tensor


def linear_map(matrix: Tensor, points: Tensor) -> Tensor:
    """M p of matrices M [..., R, 3] and points p [..., P, 3]: [..., P, R].

    No matrix product: autocast would round one to bfloat16, and CUDA to TF32, which are wrong by
    pixels where a point is projected.
    """
    x, y, z = matrix.unsqueeze(-3).unbind(-1)  # the columns
    return points[..., :1] * x + points[..., 1:2] * y + points[..., 2:] * z


def transform(b_T_a: Tensor, points: Tensor) -> Tensor:
    """Points [..., P, 3] of frame a, in frame b, by the rigid transforms [..., 4, 4]."""
    return linear_map(b_T_a[..., :3, :3], points) + b_T_a[..., None, :3, 3]


def invert_pose(b_T_a: Tensor) -> Tensor:
    """Inverse a_T_b of rigid transforms [..., 4, 4]."""
    rotation = b_T_a[..., :3, :3].transpose(-1, -2)
    inverse = torch.zeros_like(b_T_a)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3] = -linear_map(rotation, b_T_a[..., None, :3, 3]).squeeze(-2)
    inverse[..., 3, 3] = 1
    return inverse


def is_valid_pose(world_T_cam: Tensor, tolerance: float = 1e-2) -> Tensor:
    """Whether each [..., 4, 4] is finite and rigid (orthonormal, right-handed): bool [...].

    Poses with NaN or infinity mean "frame lost" (ScanNet).
    """
    finite = torch.isfinite(world_T_cam).flatten(-2).all(-1)
    pose = torch.nan_to_num(world_T_cam.double(), nan=0.0, posinf=0.0, neginf=0.0)
    rotation = pose[..., :3, :3]
    identity = torch.eye(3, dtype=pose.dtype, device=pose.device)
    error = (rotation @ rotation.transpose(-1, -2) - identity).abs().flatten(-2).amax(-1)
    bottom = (pose[..., 3, :] - pose.new_tensor([0.0, 0.0, 0.0, 1.0])).abs().amax(-1)
    return finite & (error < tolerance) & (torch.linalg.det(rotation) > 0) & (bottom < tolerance)


def rotation_between(a: Tensor, b: Tensor) -> Tensor:
    """The smallest rotation [3, 3] that takes direction a [3] to direction b [3]."""
    start, end = F.normalize(a.double(), dim=0), F.normalize(b.double(), dim=0)
    identity = torch.eye(3, dtype=start.dtype, device=a.device)
    half = start + end
    if half.norm() < 1e-8:  # opposite: half a turn about any perpendicular axis
        half = torch.linalg.cross(start, identity[int(start.abs().argmin())])
    half = F.normalize(half, dim=0)
    # Half a turn about a, then about the bisector: orthonormal to rounding for every a and b.
    turns = [2 * torch.outer(axis, axis) - identity for axis in (half, start)]
    return (turns[0] @ turns[1]).to(a.dtype)


def rotation_about_z(angle: float) -> Tensor:
    """Rotation [3, 3] by an angle in radians about the vertical."""
    c, s = math.cos(angle), math.sin(angle)
    return torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def pose_distance(a: ArrayLike, b: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far apart camera-to-world poses [..., 4, 4] are (DeepVideoMVS, Duzceker et al. 2021).

    With the relative pose inv(a) b = (R, t), the rotation counts sqrt(2 (1 - min(3, tr R) / 3))
    and the translation |t| in metres.

    Returns:
        (combined, rotation, translation) [...], where combined = sqrt(rotation^2 + translation^2).
    """
    first, second = np.asarray(a, np.float64), np.asarray(b, np.float64)
    trace = (first[..., :3, :3] * second[..., :3, :3]).sum((-2, -1))  # tr(Ra^T Rb)
    rotation = np.sqrt(2 * (1 - np.minimum(3.0, trace) / 3))
    translation = np.linalg.norm(second[..., :3, 3] - first[..., :3, 3], axis=-1)
    return np.hypot(rotation, translation), rotation, translation
