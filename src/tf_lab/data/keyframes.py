"""Which frames are worth fusing: DeepVideoMVS' pose distance (DESIGN "Keyframes")."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike


def pose_distance(a: ArrayLike, b: ArrayLike) -> tuple[float, float, float]:
    """How far apart two camera-to-world poses [4, 4] are (arrays or tensors).

    With the relative pose inv(a) b = (R, t), the rotation counts sqrt(2 (1 - min(3, tr R) / 3))
    and the translation |t| in metres.

    Returns:
        (combined, rotation, translation), where combined = sqrt(rotation^2 + translation^2).
    """
    first, second = np.asarray(a, np.float64), np.asarray(b, np.float64)
    trace = float(np.sum(first[:3, :3] * second[:3, :3]))  # tr(Ra^T Rb)
    rotation = math.sqrt(2 * (1 - min(3.0, trace) / 3))
    translation = float(np.linalg.norm(second[:3, 3] - first[:3, 3]))  # |Ra^T (tb - ta)|
    return math.hypot(rotation, translation), rotation, translation


def select_keyframes(world_T_cam: ArrayLike, threshold: float = 0.1) -> list[int]:
    """Indices of the keyframes of a sequence of poses [N, 4, 4], in order.

    The first frame is one, and each that is at least ``threshold`` from the last keyframe.
    """
    poses = np.asarray(world_T_cam, np.float64)
    keyframes: list[int] = []
    for index, pose in enumerate(poses):
        if not keyframes or pose_distance(poses[keyframes[-1]], pose)[0] >= threshold:
            keyframes.append(index)
    return keyframes
