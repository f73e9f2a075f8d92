"""Tokens: what a view says about a point, FCN(phi_i, d_i, v_i, r_i) (paper, Sec. 3.1)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from tf_lab.geometry import in_view, invert_pose, project, sample_maps, view_rays

DEPTH_CENTER, DEPTH_SCALE = 2.0, 1.5  # metres; brings 0.3..5 m to about -1..2


class Measurements(NamedTuple):
    """What `Tokens` embeds.

    Attributes:
        phi: [..., C] sampled features; read as zero where invalid.
        depth: [...] camera-space depth in metres.
        valid: [...] bool, the projection lies on the image.
        ray: [..., 3] unit rays.
    """

    phi: Tensor
    depth: Tensor
    valid: Tensor
    ray: Tensor


class Tokens(nn.Module):
    """Linear([phi, d, v, r]) -> D.

    Args:
        features: channels of the feature map.
        width: D.
        depth: whether the projected depth is an input (``inputs=no_depth`` without).
        ray: whether the viewing ray is an input (``inputs=no_ray`` without).
    """

    def __init__(self, features: int, width: int, depth: bool, ray: bool) -> None:
        super().__init__()
        self.depth, self.ray = depth, ray
        self.linear = nn.Linear(features + 1 + int(depth) + 3 * int(ray), width)
        with torch.no_grad():  # features reach the attention unmixed; the linear layer learns on
            nn.init.eye_(self.linear.weight[:, :features])

    def forward(self, phi: Tensor, depth: Tensor, valid: Tensor, ray: Tensor) -> Tensor:
        """Embed measurements, see `Measurements`: [..., D]."""
        v = valid.unsqueeze(-1).to(phi.dtype)
        parts = [phi * v, v]
        if self.depth:
            parts.append(((depth - DEPTH_CENTER) / DEPTH_SCALE).clamp(-3, 3).unsqueeze(-1))
        if self.ray:
            parts.append(ray)
        return self.linear(torch.cat([p.to(phi.dtype) for p in parts], dim=-1))


def measure(
    maps: Tensor,
    points: Tensor,
    K: Tensor,
    world_T_cam: Tensor,
    size: tuple[int, int],
    depth_range: tuple[float, float],
) -> Measurements:
    """Project points into views and sample their maps.

    Args:
        maps: [N, C, h, w].
        points: [P, 3] or [N, P, 3], metres.
        K: [N, 3, 3], pixels of the image.
        world_T_cam: [N, 4, 4].
        size: (width, height) of the image, pixels.
        depth_range: nearest and farthest valid depth, metres.

    Returns:
        phi [N, P, C], depth [N, P], valid [N, P], ray [N, P, 3].
    """
    uv, depth = project(points, K, invert_pose(world_T_cam))
    valid = in_view(uv, depth, size, *depth_range)
    return Measurements(sample_maps(maps, uv, size), depth, valid, view_rays(points, world_T_cam))
