"""Lenses by their published formulas, independent of OpenCV and of tf_lab; a world to look at.

The formulas are those of OpenCV's documentation (and of COLMAP's camera models, which are cases of
them): ``perspective`` with k1, k2, p1, p2, k3 to k6, ``fisheye`` with k1 to k4.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

Lens = Callable[[np.ndarray], np.ndarray]  # slopes x / z, y / z [..., 2] -> bent ones


def perspective(k1=0, k2=0, p1=0, p2=0, k3=0, k4=0, k5=0, k6=0) -> Lens:  # type: ignore[no-untyped-def]
    def bend(slopes: np.ndarray) -> np.ndarray:
        x, y = slopes[..., 0], slopes[..., 1]
        r2 = x * x + y * y
        radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([u, v], axis=-1)

    return bend


def fisheye(k1=0, k2=0, k3=0, k4=0) -> Lens:  # type: ignore[no-untyped-def]
    def bend(slopes: np.ndarray) -> np.ndarray:
        r = np.maximum(np.linalg.norm(slopes, axis=-1, keepdims=True), 1e-12)
        angle = np.arctan(r)
        bent = angle * (1 + k1 * angle**2 + k2 * angle**4 + k3 * angle**6 + k4 * angle**8)
        return slopes * bent / r

    return bend


def unbent(lens: Lens, bent: np.ndarray) -> np.ndarray:
    """The slopes that a lens bends to those given [..., 2]: Newton's method."""
    slopes, step = bent.copy(), 1e-6
    for _ in range(12):
        error = lens(slopes) - bent
        columns = [(lens(slopes + d) - lens(slopes - d)) / (2 * step) for d in np.eye(2) * step]
        correction = np.linalg.solve(np.stack(columns, axis=-1), error[..., None])[..., 0]
        slopes = slopes - np.clip(correction, -0.2, 0.2)
    return slopes


def pixels(size: tuple[int, int]) -> np.ndarray:
    """The centres of all pixels [H, W, 2], integers."""
    return np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), axis=-1).astype(float)


def slopes_of(K: np.ndarray, size: tuple[int, int], lens: Lens | None = None) -> np.ndarray:
    """Where all pixels look: slopes [H, W, 2]."""
    bent = (pixels(size) - K[:2, 2]) / K[[0, 1], [0, 1]]
    return bent if lens is None else unbent(lens, bent)


def colours(slopes: np.ndarray) -> np.ndarray:
    """A smooth, coloured world at infinity, as the eye sees it: float [..., 3]."""
    x, y = np.moveaxis(slopes / np.sqrt(1 + (slopes**2).sum(-1, keepdims=True)), -1, 0)
    waves = [np.sin(3 * x + 0.5) * np.cos(2 * y), np.cos(4 * y + x), np.sin(2 * x - 3 * y)]
    return 128 + 100 * np.stack(waves, axis=-1)


def photograph(K: np.ndarray, size: tuple[int, int], lens: Lens | None = None) -> np.ndarray:
    """The world's image uint8 [H, W, 3] through a camera."""
    return np.round(colours(slopes_of(K, size, lens))).astype(np.uint8)


def plane_depth(plane: np.ndarray, cam_T_world: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Camera z [H, W] of the plane n p = d in the world, where the slopes look; (n, d) [4]."""
    normal = cam_T_world[:3, :3] @ plane[:3]
    distance = plane[3] + normal @ cam_T_world[:3, 3]
    rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
    return np.asarray(distance / (rays @ normal))


def moved(rotation: list[float], translation: list[float]) -> np.ndarray:
    """A rigid transform [4, 4] from a rotation vector and a translation."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
    pose[:3, 3] = translation
    return pose
