"""Inputs of the network's forward pass of known geometry."""

import math
from typing import Any

import torch

from tf_lab.geometry import VoxelGrid
from tf_lab.network.chunks import Views

COARSE = VoxelGrid((-0.3, -0.3, -0.3), 0.3, (7, 7, 7))
FINE = VoxelGrid((0.0, 0.0, 0.0), 0.1, (15, 15, 15))


def toy(batch: int = 2, views: int = 3, seed: int = 0) -> dict[str, Any]:
    """Cameras 1.2 m from the chunk's centre that look at it, and random images."""
    generator = torch.Generator().manual_seed(seed)
    K = torch.tensor([[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]])
    poses = torch.eye(4).repeat(batch, views, 1, 1)
    for b in range(batch):
        for i in range(views):
            yaw = 2 * math.pi * (i / views + 0.1 * b)
            forward = torch.tensor([math.cos(yaw), math.sin(yaw), 0.0])
            right = torch.tensor([math.sin(yaw), -math.cos(yaw), 0.0])
            down = torch.tensor([0.0, 0.0, -1.0])
            poses[b, i, :3, :3] = torch.stack([right, down, forward], dim=1)
            poses[b, i, :3, 3] = 0.75 - 1.2 * forward
    images = torch.randint(0, 256, (batch, views, 3, 24, 32), generator=generator).float()
    return {
        "views": Views(images, K.expand(batch, views, 3, 3), poses),
        "coarse_grid": COARSE,
        "fine_grid": FINE,
        "points": 1.5 * torch.rand(batch, 40, 3, generator=generator),
        "coarse_target": torch.rand(batch, 7, 7, 7, generator=generator) < 0.3,
    }
