"""What a camera can see: the pyramid between its nearest and its farthest depth."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from tf_lab.geometry.poses import linear_map, transform


def frustum_sides(K: Tensor, size: tuple[int, int]) -> Tensor:
    """Unit normals [..., 4, 3], inwards, of the camera-space planes through the image's edges.

    Args:
        K: [..., 3, 3], pixels.
        size: (width, height) of the image, pixels.
    """
    u, v, w = K.unbind(-2)
    # u >= -0.5 is (K[0] + 0.5 K[2]) c >= 0 for camera-space points c, and so on
    right, bottom = (n - 0.5 for n in size)
    sides = [u + 0.5 * w, right * w - u, v + 0.5 * w, bottom * w - v]
    return F.normalize(torch.stack(sides, -2), dim=-1)


def frustum_planes(
    K: Tensor, world_T_cam: Tensor, size: tuple[int, int], near: float, far: float
) -> Tensor:
    """The six planes of a frustum: inward unit normals n and offsets d (metres), [..., 6, 4].

    A point p is in the frustum if all n p + d are at least 0; a ball of radius r around it can only
    touch the frustum if all are at least -r.

    Args:
        K: [..., 3, 3], pixels.
        world_T_cam: [..., 4, 4].
        size: (width, height) of the image, pixels.
        near: least camera z, metres.
        far: greatest camera z, metres.
    """
    sides = frustum_sides(K, size)
    ahead = sides.new_tensor([[0, 0, 1], [0, 0, -1]]).expand(*sides.shape[:-2], 2, 3)
    normals = torch.cat([sides, ahead], -2) @ world_T_cam[..., :3, :3].transpose(-1, -2)
    offsets = normals.new_tensor([0, 0, 0, 0, -near, far])
    offsets = offsets - linear_map(normals, world_T_cam[..., None, :3, 3]).squeeze(-2)
    return torch.cat([normals, offsets.unsqueeze(-1)], -1)


def frustum_corners(
    K: Tensor, world_T_cam: Tensor, size: tuple[int, int], near: float, far: float
) -> Tensor:
    """The eight corners of a frustum [..., 8, 3], metres; arguments as of `frustum_planes`."""
    right, bottom = (n - 0.5 for n in size)
    edges = [[-0.5, -0.5, 1], [right, -0.5, 1], [-0.5, bottom, 1], [right, bottom, 1]]
    rays = K.new_tensor(edges) @ torch.linalg.inv(K).transpose(-1, -2)
    return transform(world_T_cam, torch.cat([rays * near, rays * far], -2))
