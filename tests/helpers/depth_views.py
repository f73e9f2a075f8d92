"""Depth images of a floor, by their definition."""

import math

import numpy as np
import torch
from torch import Tensor

from helpers import box_room
from tf_lab.geometry import VoxelGrid

SIZE = (120, 90)
K = torch.tensor([[100.0, 0, 59.5], [0, 100.0, 44.5], [0, 0, 1]])
# a camera 1.5 m above the plane z = 0 that looks straight down
DOWN = torch.tensor([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1.5], [0, 0, 0, 1]])
TRUNCATION, FAR = 0.12, 6.0


def look_from(eye: tuple[float, float, float], target: tuple[float, float, float]) -> Tensor:
    delta = np.subtract(target, eye)
    yaw, pitch = math.atan2(delta[1], delta[0]), math.atan2(delta[2], math.hypot(*delta[:2]))
    return torch.from_numpy(box_room.look(np.array(eye), yaw, pitch)).float()


def rays(pose: Tensor) -> Tensor:
    """World directions [h, w, 3] of the pixels, of camera z 1."""
    v, u = np.indices((SIZE[1], SIZE[0]))
    camera = np.stack([(u - 59.5) / 100, (v - 44.5) / 100, np.ones(u.shape)], -1)
    return torch.from_numpy(camera).float() @ pose[:3, :3].T


def plane_depth(pose: Tensor, height: float = 0.0) -> Tensor:
    """Depth of the plane z = height seen from above; 0 where it isn't hit."""
    z = rays(pose)[..., 2]
    depth = (height - pose[2, 3]) / z
    return torch.where((z < -1e-6) & (depth < 20), depth, 0.0)


def corridor(length: float, voxel: float) -> tuple[list[Tensor], Tensor, Tensor, VoxelGrid]:
    """Frames of cameras that look down along a floor of the given length (metres)."""
    eyes = np.arange(0.4, length, 0.5)
    poses = DOWN.repeat(len(eyes), 1, 1)
    poses[:, 0, 3] = torch.from_numpy(eyes).float()
    poses[::2, :3, :3] = look_from((0, 0, 1.5), (0.7, 0.2, 0))[:3, :3]
    depths = [plane_depth(pose) for pose in poses]
    grid = VoxelGrid.covering((-0.2, -1, -0.2), (length, 1, 1.8), voxel)
    return depths, K.expand(len(poses), 3, 3), poses, grid
