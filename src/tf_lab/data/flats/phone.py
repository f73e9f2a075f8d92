"""A hand-held phone's camera: exposure that adapts, motion blur, rolling shutter."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tf_lab.data.rooms.render import Renderer, develop
from tf_lab.data.rooms.walk import wave

Rng = np.random.Generator
ADAPTS = 0.2  # the share of the way to the right exposure that is made between two frames
TAPS = 9  # images of which a blurred one is the mean, at most
TURN = 1.2  # radians: who films turns by at most so much in the time that a metre of way takes


@dataclass(frozen=True)
class Phone:
    """A phone and how it is held.

    Attributes:
        field_of_view: horizontal, radians.
        shutter: seconds that each row is exposed.
        readout: seconds from the first row's exposure to the last's.
        pace: walking speed, metres a second, where the camera turns little.
        height: usual height of the camera, metres.
        key: mean linear brightness that the exposure aims at.
    """

    field_of_view: float
    shutter: float
    readout: float
    pace: float
    height: float
    key: float


def make_phone(rng: Rng) -> Phone:
    """Any of those in use."""
    return Phone(
        field_of_view=np.radians(rng.uniform(50, 75)),
        shutter=rng.uniform(0.006, 0.03),
        readout=rng.uniform(0.012, 0.03),
        pace=rng.uniform(0.2, 0.45),
        height=rng.uniform(1.25, 1.6),
        key=rng.uniform(0.2, 0.34),
    )


@dataclass(frozen=True)
class Motion:
    """How a camera moves: velocity [3] (m/s, world), angular velocity [3] (rad/s, camera)."""

    velocity: np.ndarray
    turn: np.ndarray

    def poses(self, pose: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Poses [N, 4, 4] at times [N] (s) after that of a pose."""
        found = np.tile(pose, (len(times), 1, 1))
        turned = Rotation.from_rotvec(np.outer(times, self.turn)).as_matrix()
        found[:, :3, :3] = pose[:3, :3] @ turned
        found[:, :3, 3] += np.outer(times, self.velocity)
        return found

    def flow(self, pose: np.ndarray, depth: np.ndarray, K: np.ndarray) -> np.ndarray:
        """How fast pixels move, float32 [H, W, 2] in pixels a second, given their depth [H, W]."""
        height, width = depth.shape
        x, y = (np.arange(width) - K[0, 2]) / K[0, 0], (np.arange(height) - K[1, 2]) / K[1, 1]
        ray = np.stack([*np.meshgrid(x, y), np.ones_like(depth)], axis=-1)
        # a point of the world, seen from the camera: -(R^T v) - w x p
        seen = -(pose[:3, :3].T @ self.velocity) / np.maximum(depth, 0.1)[..., None]
        seen = seen - np.cross(self.turn, ray)
        flow = seen[..., :2] - ray[..., :2] * seen[..., 2:]
        return (flow * [K[0, 0], K[1, 1]]).astype(np.float32)


def pass_times(trail: np.ndarray, pace: float) -> np.ndarray:
    """When poses [N, 4, 4] are passed, [N] (s): one walks at ``pace``, and more slowly in turns."""
    way = np.linalg.norm(np.diff(trail[:, :3, 3], axis=0), axis=1)
    turned = Rotation.from_matrix(trail[:-1, :3, :3].swapaxes(1, 2) @ trail[1:, :3, :3])
    return np.concatenate([[0], np.cumsum(np.maximum(way, turned.magnitude() / TURN))]) / pace


def motion_at(trail: np.ndarray, times: np.ndarray, number: int) -> Motion:
    """The motion at one of the poses [N, 4, 4], passed at times [N] (s)."""
    first, last = max(number - 1, 0), min(number + 1, len(trail) - 1)
    time = times[last] - times[first]
    turn = Rotation.from_matrix(trail[first, :3, :3].T @ trail[last, :3, :3]).as_rotvec()
    return Motion((trail[last, :3, 3] - trail[first, :3, 3]) / time, turn / time)


def blur(image: np.ndarray, path: np.ndarray) -> np.ndarray:
    """An image [H, W, 3], smeared along each pixel's path [H, W, 2] (pixels) during exposure."""
    longest = float(np.linalg.norm(path, axis=-1).max())
    taps = min(TAPS, 1 + int(np.ceil(longest)))
    if taps == 1:
        return image
    image = image.astype(np.float32)
    v, u = np.indices(image.shape[:2], dtype=np.float32)
    total = np.zeros_like(image)
    for part in (np.arange(taps, dtype=np.float32) + 0.5) / taps - 0.5:
        where = u + part * path[..., 0], v + part * path[..., 1]
        total += cv2.remap(image, *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return total / taps


class Filming:
    """A film of a walk, frame by frame.

    Args:
        phone: the camera.
        renderer: of the scene, for the phone's intrinsics.
        K: [3, 3], those.
        frames: how many.
        rng: the random source.
    """

    def __init__(
        self, phone: Phone, renderer: Renderer, K: np.ndarray, frames: int, rng: Rng
    ) -> None:
        self._phone, self._renderer, self._K, self._rng = phone, renderer, K, rng
        self._gain: float | None = None
        drift = 0.08 * wave(rng, frames, 12)
        balance = 0.03 * np.stack([wave(rng, frames, 25) for _ in range(3)], axis=-1)
        self._drift = np.exp(drift[:, None] + balance)

    def frame(self, number: int, pose: np.ndarray, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        """A photograph uint8 [H, W, 3] and the depth float32 [H, W] (m) at the pose.

        The pose is that of the middle row; rows above it are exposed before, those below after.
        """
        depth = self._renderer.depth(pose)
        rows = np.linspace(-0.5, 0.5, len(depth)) * self._phone.readout
        linear, _ = self._renderer.render(motion.poses(pose, rows))
        linear = blur(linear, motion.flow(pose, depth, self._K) * self._phone.shutter)
        return develop(linear, self._expose(linear, number), self._rng), depth

    def _expose(self, linear: np.ndarray, number: int) -> np.ndarray:
        """The gain of each channel [3]: it follows the brightness, and drifts."""
        right = self._phone.key / max(float(linear.mean()), 1e-4)
        before = right if self._gain is None else self._gain
        self._gain = before * (right / before) ** ADAPTS
        return self._gain * self._drift[number]
