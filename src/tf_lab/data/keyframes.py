"""Which frames are worth fusing: DeepVideoMVS' pose distance (Duzceker et al. 2021)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tf_lab.data.capture import Altered, Capture
from tf_lab.geometry import pose_distance

KEYFRAME_DISTANCE = 0.1  # as in DeepVideoMVS, and in the line of work of the paper


def select_keyframes(world_T_cam: ArrayLike, threshold: float = KEYFRAME_DISTANCE) -> list[int]:
    """Indices of the keyframes of a sequence of poses [N, 4, 4], in order.

    The first frame is one, and each that is at least ``threshold`` from the last keyframe.
    """
    poses = np.asarray(world_T_cam, np.float64)
    keyframes: list[int] = []
    for index, pose in enumerate(poses):
        if not keyframes or pose_distance(poses[keyframes[-1]], pose)[0] >= threshold:
            keyframes.append(index)
    return keyframes


class Thinned(Altered):
    """A `Capture` of a few of another's keyframes, evenly chosen.

    Args:
        capture: the other.
        frames: how many, if it has so many.
        threshold: see `select_keyframes`.
    """

    def __init__(self, capture: Capture, frames: int, threshold: float = KEYFRAME_DISTANCE) -> None:
        keyframes = select_keyframes(capture.world_T_cam, threshold)
        count = min(frames, len(keyframes))
        self.kept = [keyframes[i] for i in np.linspace(0, len(keyframes) - 1, count).astype(int)]
        super().__init__(capture)
        self.frames = [capture.frames[i] for i in self.kept]
        self.K, self.world_T_cam = capture.K[self.kept], capture.world_T_cam[self.kept]

    def image(self, index: int) -> np.ndarray:
        """uint8 [H, W, 3] RGB."""
        return super().image(self.kept[index])

    def depth(self, index: int) -> np.ndarray | None:
        """float32 [H, W] metres, 0 where unknown; None without depth."""
        return super().depth(self.kept[index])
