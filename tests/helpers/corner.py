"""A corner of a room with a pattern on its walls and floor, seen without any renderer."""

from __future__ import annotations

import numpy as np

from helpers.box_room import intrinsics, look
from tf_lab.errors import TFLabError

SIZE = (160, 120)
WALLS = (2.0, 1.5, 0.0)  # metres: the walls x = and y =, the floor z =


class Corner:
    """A `Capture` of frames whose every pixel is of a known point.

    Args:
        frames: how many, along a path across the corner; each looks into it.
        broken: frames that cannot be read.
    """

    def __init__(self, frames: int = 24, broken: tuple[int, ...] = ()) -> None:
        self.name, self.size, self.skipped = "corner", SIZE, []
        self.frames = [f"{i:03d}" for i in range(frames)]
        self.source_T_world = np.eye(4)
        self.K = np.tile(intrinsics(SIZE, 130.0), (frames, 1, 1))
        ways = np.linspace(-0.6, 0.6, frames)
        self.world_T_cam = np.stack(
            [
                look(np.array([0.3 * w, -w, 1.2 + 0.2 * np.sin(5 * w)]), 0.6 + 0.4 * w, -0.25)
                for w in ways
            ]
        )
        self.broken = broken
        rng = np.random.default_rng(5)
        self.waves = rng.normal(size=(60, 3)) * 25  # radians a metre
        self.phases = rng.uniform(0, 2 * np.pi, 60)

    def points(self, index: int) -> np.ndarray:
        """What each pixel sees, [H, W, 3] in the world."""
        pose, K = self.world_T_cam[index], self.K[index]
        u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
        rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(K).T @ pose[:3, :3].T
        ways = (np.array(WALLS) - pose[:3, 3]) / rays
        return pose[:3, 3] + rays * np.where(ways > 0, ways, np.inf).min(-1, keepdims=True)

    def image(self, index: int) -> np.ndarray:
        """uint8 [H, W, 3]."""
        if index in self.broken:
            raise TFLabError(f"{self.frames[index]}: cannot be read")
        waves = np.sin(self.points(index) @ self.waves.T + self.phases).sum(-1)
        grey = np.clip(127 + 127 * waves / 15, 0, 255).astype(np.uint8)
        return np.repeat(grey[..., None], 3, -1)

    def depth(self, index: int) -> np.ndarray | None:
        """None is known."""
        return None
