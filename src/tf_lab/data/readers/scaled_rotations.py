"""Rotations that are all scaled by one factor, as Blender and instant-ngp export scaled cameras."""

from __future__ import annotations

import numpy as np
import torch

from tf_lab.geometry import is_valid_pose

ROUNDING = 5e-3  # factors nearer to 1 are none, as for `is_valid_pose`
SMALLEST = 1e-6  # factor, and one over the largest


def unscaled(poses: np.ndarray) -> tuple[np.ndarray, float]:
    """Poses [N, 4, 4] without the factor that most of their rotations have, and the factor.

    Translations stay. The factor is 1 where without it no more of the poses would be rigid.
    """
    finite = poses[np.isfinite(poses).all((1, 2))]
    factors = np.sort(np.cbrt(np.linalg.det(finite[:, :3, :3])))
    factor = float(factors[len(factors) // 2]) if len(factors) else 1.0
    if abs(factor - 1) < ROUNDING or not SMALLEST < factor < 1 / SMALLEST:
        return poses, 1.0
    without = poses.copy()
    without[:, :3, :3] /= factor
    return (without, factor) if _rigid(without) > _rigid(poses) else (poses, 1.0)


def _rigid(poses: np.ndarray) -> int:
    """How many of the poses [N, 4, 4] are rigid."""
    return int(is_valid_pose(torch.from_numpy(poses)).sum())
