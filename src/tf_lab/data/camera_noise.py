"""Errors of cameras, as tracking and calibration leave them, drawn at random for a chunk."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from tf_lab.data.settings import CameraNoise


def disturb_cameras(
    K: Tensor, world_T_cam: Tensor, noise: CameraNoise, rng: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """The cameras of a chunk, a little wrong.

    Args:
        K: [V, 3, 3].
        world_T_cam: [V, 4, 4].
        noise: how wrong, at most.
        rng: the random source.

    Returns:
        K and world_T_cam like the given ones, which stay as they are.
    """
    share, count = rng.uniform(), len(K)
    turn = share * np.radians(noise.rotation) * rng.standard_normal((count, 3))
    shift = share * noise.translation * rng.standard_normal((count, 3))
    scale = np.exp(share * noise.focal * rng.standard_normal())
    K, world_T_cam = K.clone(), world_T_cam.clone()
    K[:, [0, 1], [0, 1]] *= scale
    turned = torch.from_numpy(Rotation.from_rotvec(turn).as_matrix()).to(world_T_cam)
    world_T_cam[:, :3, :3] = world_T_cam[:, :3, :3] @ turned
    world_T_cam[:, :3, 3] += torch.from_numpy(shift).to(world_T_cam)
    return K, world_T_cam
