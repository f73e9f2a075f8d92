"""Errors of cameras, as tracking and calibration leave them: to train with, to see their cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tf_lab.data.capture import Altered, Capture
from tf_lab.data.settings import CameraNoise


def disturb_cameras(
    K: np.ndarray, world_T_cam: np.ndarray, noise: CameraNoise, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Cameras, a little wrong: every pose by itself, the focal lengths all by the same factor.

    Args:
        K: [N, 3, 3].
        world_T_cam: [N, 4, 4].
        noise: how wrong.
        rng: the random source.

    Returns:
        K and world_T_cam like the given ones, which stay as they are.
    """
    turn = np.radians(noise.rotation) * rng.standard_normal((len(K), 3))
    shift = noise.translation * rng.standard_normal((len(K), 3))
    K, world_T_cam = K.copy(), world_T_cam.copy()
    K[:, [0, 1], [0, 1]] *= np.exp(noise.focal * rng.standard_normal())
    world_T_cam[:, :3, :3] = world_T_cam[:, :3, :3] @ Rotation.from_rotvec(turn).as_matrix()
    world_T_cam[:, :3, 3] += shift
    return K, world_T_cam


def share_of(noise: CameraNoise, share: float) -> CameraNoise:
    """Noise whose deviations are a share of the given one's."""
    return replace(noise, **{name: share * value for name, value in vars(noise).items()})


class Disturbed(Altered):
    """A `Capture` whose cameras are a little wrong, always in the same way."""

    def __init__(self, capture: Capture, noise: CameraNoise) -> None:
        super().__init__(capture)
        rng = np.random.default_rng(0)
        self.K, self.world_T_cam = disturb_cameras(capture.K, capture.world_T_cam, noise, rng)
