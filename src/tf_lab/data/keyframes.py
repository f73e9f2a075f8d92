"""Which frames are worth fusing: DeepVideoMVS' pose distance (Duzceker et al. 2021)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tf_lab.geometry import pose_distance


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
