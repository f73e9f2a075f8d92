"""Frames of one textured plane in front of a camera: depth is known by a formula."""

import numpy as np

DISTANCE = 2.0  # metres from the first camera, on its axis


def intrinsics(width: int) -> np.ndarray:
    """A camera of 53 degrees, width to height 4 to 3."""
    focal = float(width)
    return np.array([[focal, 0, width / 2 - 0.5], [0, focal, width * 0.375 - 0.5], [0, 0, 1]])


def wall_depth(x: float, tilt: float, width: int) -> np.ndarray:
    """Depth [H, W] seen by a camera at (x, 0, 0) that looks along z: z = 2 m + tilt * X."""
    across, _ = _rays(width)
    return (DISTANCE + tilt * x) / (1 - tilt * across)


def frame(x: float, tilt: float, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Image uint8 [H, W, 3], K and world_T_cam of that camera."""
    across, down = _rays(width)
    depth = wall_depth(x, tilt, width)
    grey = _texture(x + depth * across, depth * down)
    pose = np.eye(4)
    pose[0, 3] = x
    image = np.repeat((255 * grey).round().astype(np.uint8)[..., None], 3, axis=-1)
    return image, intrinsics(width), pose


def _rays(width: int) -> tuple[np.ndarray, np.ndarray]:
    K = intrinsics(width)
    u, v = np.meshgrid(np.arange(width), np.arange(width * 3 // 4))
    return (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]


def _texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Waves of many directions, 12 cm and longer: some pixels each, so that sampling is exact."""
    rng = np.random.default_rng(0)
    total = np.zeros_like(x)
    for _ in range(40):
        length, angle, phase = rng.uniform(0.12, 0.8), rng.uniform(0, np.pi), rng.uniform(0, 6.28)
        total += np.sin(2 * np.pi / length * (np.cos(angle) * x + np.sin(angle) * y) + phase)
    return 0.5 + 0.5 * np.clip(total / 12, -1, 1)
