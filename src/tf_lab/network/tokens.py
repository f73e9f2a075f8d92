"""Tokens: what a view says about a point, FCN(phi_i, d_i, v_i, r_i) (paper, Sec. 3.1)."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor, nn

from tf_lab.geometry import in_view, project, view_rays

DEPTH_CENTER, DEPTH_SCALE = 2.0, 1.5  # metres; brings 0.3..5 m to about -1..2


class Measurements(NamedTuple):
    """What `Tokens` embeds.

    Attributes:
        phi: [..., C] sampled features; read as zero where invalid.
        depth: [...] camera-space depth in metres.
        valid: [...] bool, the projection lies on the image, within the network's range of depth.
        ray: [..., 3] unit rays.
        stereo: [..., 2] what the view's own depth map says at the projection, metres (0: nothing)
            and the score there; [..., 0] without such maps.
    """

    phi: Tensor
    depth: Tensor
    valid: Tensor
    ray: Tensor
    stereo: Tensor

    def each(self, change: Callable[[Tensor], Tensor]) -> Measurements:
        """All of them, changed alike."""
        return Measurements(*map(change, self))

    def of_views(self, views: Tensor) -> Measurements:
        """Those of views int64 [P, K] out of [P, V, ...]."""
        index = views.unsqueeze(-1)
        return Measurements(
            torch.take_along_dim(self.phi, index, dim=1),
            self.depth.gather(1, views),
            self.valid.gather(1, views),
            torch.take_along_dim(self.ray, index, dim=1),
            torch.take_along_dim(self.stereo, index, dim=1),
        )


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

    def forward(self, measured: Measurements) -> Tensor:
        """Embed measurements: [..., D]."""
        phi, depth, valid, ray, _ = measured
        v = valid.unsqueeze(-1).to(phi.dtype)
        parts = [phi * v, v]
        if self.depth:
            parts.append(((depth - DEPTH_CENTER) / DEPTH_SCALE).clamp(-3, 3).unsqueeze(-1))
        if self.ray:
            parts.append(ray)
        return self.linear(torch.cat([p.to(phi.dtype) for p in parts], dim=-1))


def measure(
    points: Tensor,
    K: Tensor,
    world_T_cam: Tensor,
    cam_T_world: Tensor,
    size: tuple[int, int],
    depth_range: tuple[float, float],
    sample: Callable[[Tensor], Tensor],
    stereo: Callable[[Tensor], Tensor] | None = None,
) -> Measurements:
    """What views say of points.

    Args:
        points: [..., P, 3], metres.
        K: [..., 3, 3], pixels of the image.
        world_T_cam: [..., 4, 4].
        cam_T_world: [..., 4, 4].
        size: (width, height) of the image, pixels.
        depth_range: nearest and farthest valid depth, metres.
        sample: features [..., P, C] of the views at pixels [..., P, 2].
        stereo: what their depth maps say there, [..., P, 2]; None: there are none.

    Returns:
        phi [..., P, C], depth [..., P], valid [..., P], ray [..., P, 3], stereo [..., P, 2 or 0].
    """
    uv, depth = project(points, K, cam_T_world)
    valid = in_view(uv, depth, size, *depth_range)
    phi = sample(uv)
    told = phi.new_zeros(*uv.shape[:-1], 0) if stereo is None else stereo(uv)
    return Measurements(phi, depth, valid, view_rays(points, world_T_cam), told)
