"""Projection and sampling of images."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.geometry.poses import linear_map, transform

MIN_FOCAL = 0.05  # of the image's side: a field of view of 168 degrees


def pinhole(size: tuple[int, int], field_of_view: float) -> np.ndarray:
    """K [3, 3] of square pixels, centred.

    Args:
        size: (width, height), pixels.
        field_of_view: horizontal, radians.
    """
    focal = size[0] / 2 / np.tan(field_of_view / 2)
    return np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])


def project(points: Tensor, K: Tensor, cam_T_world: Tensor) -> tuple[Tensor, Tensor]:
    """Full-perspective projection Pi_i(p) = pi(K_i (R_i p + t_i)) (paper, Sec. 3.1).

    Args:
        points: [P, 3] world points in metres, or [..., P, 3].
        K: [..., 3, 3] intrinsics in pixels.
        cam_T_world: [..., 4, 4].

    Returns:
        Pixel coordinates [..., P, 2] and camera-space depth [..., P] in metres. Where the depth is
        not positive the pixel coordinates are finite but meaningless.
    """
    camera = transform(cam_T_world, points)
    depth = camera[..., 2]
    pixels = linear_map(K, camera)
    safe = torch.where(depth.abs() < 1e-6, torch.full_like(depth, 1e-6), depth)
    return pixels[..., :2] / safe[..., None], depth


def check_focal(fx: float, fy: float, cx: float, cy: float, size: tuple[int, int]) -> None:
    """That intrinsics in pixels may be those of images of (width, height) ``size``.

    Raises:
        TFLabError: a focal length is not positive, or so short that the image would show more than
            168 degrees, as it is where the intrinsics are in other units than pixels.
    """
    if not (fx > 0 and fy > 0):
        raise TFLabError(f"fx = {fx:g}, fy = {fy:g} must be positive")
    if fx >= MIN_FOCAL * size[0] and fy >= MIN_FOCAL * size[1]:
        return
    normalised = max(fx, fy) < 10 and 0 < cx < 1 and 0 < cy < 1
    cure = (
        "they are in units of the image: multiply fx, cx by its width and fy, cy by its height"
        if normalised
        else "give them in pixels of these images"
    )
    raise TFLabError(
        f"fx = {fx:g}, fy = {fy:g} are too short for images of {size[0]}x{size[1]} pixels; {cure}"
    )


def in_view(uv: Tensor, depth: Tensor, size: tuple[int, int], near: float, far: float) -> Tensor:
    """Whether projections fall on the image and within the depth range (metres): bool [..., P].

    ``size`` is (width, height) in pixels.
    """
    width, height = size
    u, v = uv[..., 0], uv[..., 1]
    inside = (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)
    return inside & (depth >= near) & (depth <= far)


def scale_intrinsics(K: Tensor, from_size: tuple[int, int], to_size: tuple[int, int]) -> Tensor:
    """Intrinsics [..., 3, 3] after resizing the image from (w, h) to (w', h').

    With pixel centres at integers, scaling by s maps a coordinate x to (x + 0.5) s - 0.5.
    """
    sx, sy = to_size[0] / from_size[0], to_size[1] / from_size[1]
    scale = K.new_tensor([[sx, 0, 0.5 * sx - 0.5], [0, sy, 0.5 * sy - 0.5], [0, 0, 1]])
    return scale @ K


def view_rays(points: Tensor, world_T_cam: Tensor) -> Tensor:
    """Unit rays r_i = (p - c_i) / |p - c_i| from cameras [..., 4, 4] to points: [..., P, 3]."""
    return F.normalize(points - world_T_cam[..., None, :3, 3], dim=-1)


def pixel_directions(K: Tensor, size: tuple[int, int]) -> Tensor:
    """Camera-space directions [h, w, 3] through the pixel centres, scaled to z = 1."""
    width, height = size
    rows, columns = (torch.arange(n, dtype=K.dtype, device=K.device) for n in (height, width))
    v, u = torch.meshgrid(rows, columns, indexing="ij")
    pixels = torch.stack([u, v, torch.ones_like(u)], dim=-1)
    return pixels @ torch.linalg.inv(K).transpose(-1, -2)


def covered_pixels(maps: Tensor, stride: int) -> tuple[int, int]:
    """What maps [..., h, w] of a stride cover, from the image's corner on: (width, height), pixels.

    Where the stride does not divide the image's size that is more than the image: the last pixels
    of the maps reach beyond it.
    """
    return maps.shape[-1] * stride, maps.shape[-2] * stride


def sample_maps(maps: Tensor, uv: Tensor, size: tuple[int, int], mode: str = "bilinear") -> Tensor:
    """Samples of feature maps [N, C, h, w] at image pixels [N, P, 2]: [N, P, C].

    They are bilinear, or of the ``nearest`` pixel. ``size`` is the (width, height) of what the maps
    cover, in the image's pixels: the image, or `covered_pixels`. Beyond the border the nearest
    border value is returned; validity is told apart by `in_view`.
    """
    grid = (uv + 0.5) * (2.0 / constants(size, uv)) - 1.0
    grid = grid.clamp(-2, 2)  # huge coordinates of points beside the camera
    out = grid_sample(maps, grid[:, :, None], "border", mode)
    return out.squeeze(-1).transpose(1, 2)


def constants(values: Sequence[float], like: Tensor) -> Tensor:
    """Numbers [N] where another tensor is, made there: sending them would wait for a GPU."""
    return torch.stack([like.new_full((), value) for value in values])


def grid_sample(maps: Tensor, grid: Tensor, padding: str, mode: str = "bilinear") -> Tensor:
    """Torch's, but coordinates stay exact: half precision is too coarse for pixels."""
    dtype = torch.promote_types(maps.dtype, torch.float32)
    out = F.grid_sample(maps.to(dtype), grid.to(dtype), mode, padding, align_corners=False)
    return out.to(maps.dtype)
