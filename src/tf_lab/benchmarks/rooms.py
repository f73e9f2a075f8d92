"""The scene that is timed: connected box-shaped rooms, a walk through them, images of noise.

What the images show does not change how long anything takes, but how much is near a surface does.
So the networks run in full, on noise, and then the true surface takes the place of what they said.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from tf_lab.geometry import pinhole

SIZE = np.array([5.0, 4.0, 2.6])  # metres, of a room; rooms stand in a row along x
CORNER = np.array([0.13, 0.17, 0.11])  # metres, of the first room: off all lattices
FIELD_OF_VIEW = np.radians(58.0)  # horizontal


@dataclass(frozen=True)
class Rooms:
    """Connected rooms."""

    count: int

    def solid(self, points: Tensor) -> Tensor:
        """Signed distance [P] (metres) of points [P, 3] to the walls, positive in them."""
        points, size = points - points.new_tensor(CORNER), points.new_tensor(SIZE)
        room = (points[:, 0] / size[0]).floor().clamp(0, self.count - 1)
        centre = (size / 2).repeat(len(points), 1)
        centre[:, 0] += room * size[0]
        beyond = (points - centre).abs() - size / 2
        return beyond.clamp(min=0).norm(dim=1) + beyond.amax(1).clamp(max=0)


def walk(rooms: range, frames: int, size: tuple[int, int]) -> Iterator[tuple[np.ndarray, ...]]:
    """Frames (image, K, world_T_cam) of a turn in each of some rooms, ``frames`` a room."""
    rng = np.random.default_rng(0)
    K = pinhole(size, FIELD_OF_VIEW)
    for room in rooms:
        for i in range(frames):
            angle = 2 * np.pi * (i + 0.5) / frames
            eye = CORNER + SIZE * [
                room + 0.5 + 0.15 * np.cos(angle),
                0.5 + 0.15 * np.sin(angle),
                0.55,
            ]
            image = rng.integers(0, 256, (size[1], size[0], 3), np.uint8)
            yield image, K, look(eye, angle + np.pi, -0.25 * np.sin(3 * angle))


def look(eye: np.ndarray, yaw: float, pitch: float) -> np.ndarray:
    """world_T_cam [4, 4] of a camera that looks along (yaw, pitch), its image's top up."""
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = eye
    return pose
