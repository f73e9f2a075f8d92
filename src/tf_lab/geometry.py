"""Cameras, poses, rays and voxel grids: the conventions of the whole project, stated once.

* World: metres, right-handed, z up. Camera: x right, y down, z forward (OpenCV).
* ``world_T_cam`` maps camera to world coordinates; the paper's (R, t) is ``cam_T_world``.
* Pixel centres lie at integer coordinates; (0, 0) is the centre of the top-left pixel, so an image
  of width W covers [-0.5, W - 0.5).
* Voxel grids are cell-centred: voxel (i, j, k) has its centre at ``origin + (ijk + 0.5) * voxel``.

Every function works on any leading batch shape that broadcasts, unless it says otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

COARSE, FINE, CHUNK = 0.30, 0.10, 1.5  # metres; the paper's v_c, v_f and chunk edge


def linear_map(matrix: Tensor, points: Tensor) -> Tensor:
    """M p of matrices M [..., R, 3] and points p [..., P, 3]: [..., P, R].

    No matrix product: autocast would round one to bfloat16, and CUDA to TF32, which are wrong by
    pixels where a point is projected.
    """
    x, y, z = matrix.unsqueeze(-3).unbind(-1)  # the columns
    return points[..., :1] * x + points[..., 1:2] * y + points[..., 2:] * z


def transform(b_T_a: Tensor, points: Tensor) -> Tensor:
    """Points [..., P, 3] of frame a, in frame b, by the rigid transforms [..., 4, 4]."""
    return linear_map(b_T_a[..., :3, :3], points) + b_T_a[..., None, :3, 3]


def invert_pose(b_T_a: Tensor) -> Tensor:
    """Inverse a_T_b of rigid transforms [..., 4, 4]."""
    rotation = b_T_a[..., :3, :3].transpose(-1, -2)
    inverse = torch.zeros_like(b_T_a)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3] = -linear_map(rotation, b_T_a[..., None, :3, 3]).squeeze(-2)
    inverse[..., 3, 3] = 1
    return inverse


def is_valid_pose(world_T_cam: Tensor, tolerance: float = 1e-2) -> Tensor:
    """Whether each [..., 4, 4] is finite and rigid (orthonormal, right-handed): bool [...].

    Poses with NaN or infinity mean "frame lost" (ScanNet, DESIGN "Conventions").
    """
    finite = torch.isfinite(world_T_cam).flatten(-2).all(-1)
    pose = torch.nan_to_num(world_T_cam.double(), nan=0.0, posinf=0.0, neginf=0.0)
    rotation = pose[..., :3, :3]
    identity = torch.eye(3, dtype=pose.dtype, device=pose.device)
    error = (rotation @ rotation.transpose(-1, -2) - identity).abs().flatten(-2).amax(-1)
    bottom = (pose[..., 3, :] - pose.new_tensor([0.0, 0.0, 0.0, 1.0])).abs().amax(-1)
    return finite & (error < tolerance) & (torch.linalg.det(rotation) > 0) & (bottom < tolerance)


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


def sample_maps(maps: Tensor, uv: Tensor, size: tuple[int, int]) -> Tensor:
    """Bilinear samples of feature maps [N, C, h, w] at image pixels [N, P, 2]: [N, P, C].

    ``size`` is the (width, height) of the image that the pixels refer to; the stride of the map
    does not matter, because coordinates are normalised by the image. Beyond the border the
    nearest border value is returned; validity is told apart by `in_view`.
    """
    grid = (uv + 0.5) * (2.0 / uv.new_tensor(size)) - 1.0
    grid = grid.clamp(-2, 2)  # huge coordinates of points beside the camera
    out = _sample(maps, grid[:, :, None], "border")
    return out.squeeze(-1).transpose(1, 2)


def _sample(maps: Tensor, grid: Tensor, padding: str) -> Tensor:
    """`grid_sample` that keeps coordinates exact: half precision is too coarse for pixels."""
    dtype = torch.promote_types(maps.dtype, torch.float32)
    out = F.grid_sample(maps.to(dtype), grid.to(dtype), padding_mode=padding, align_corners=False)
    return out.to(maps.dtype)


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


def rotation_between(a: Tensor, b: Tensor) -> Tensor:
    """The smallest rotation [3, 3] that takes direction a [3] to direction b [3]."""
    start, end = F.normalize(a.double(), dim=0), F.normalize(b.double(), dim=0)
    identity = torch.eye(3, dtype=start.dtype, device=a.device)
    half = start + end
    if half.norm() < 1e-8:  # opposite: half a turn about any perpendicular axis
        half = torch.linalg.cross(start, identity[int(start.abs().argmin())])
    half = F.normalize(half, dim=0)
    # Half a turn about a, then about the bisector: orthonormal to rounding for every a and b.
    turns = [2 * torch.outer(axis, axis) - identity for axis in (half, start)]
    return (turns[0] @ turns[1]).to(a.dtype)


def rotation_about_z(angle: float) -> Tensor:
    """Rotation [3, 3] by an angle in radians about the vertical."""
    c, s = math.cos(angle), math.sin(angle)
    return torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class VoxelGrid:
    """An axis-aligned, cell-centred grid.

    Attributes:
        origin: the grid's lower corner (not a voxel centre), metres.
        voxel: edge length, metres.
        shape: number of voxels along x, y, z.
    """

    origin: tuple[float, float, float]
    voxel: float
    shape: tuple[int, int, int]

    @classmethod
    def covering(
        cls, lower: Sequence[float], upper: Sequence[float], voxel: float, multiple: int = 1
    ) -> VoxelGrid:
        """The smallest grid on the lattice of ``voxel * multiple`` that covers a box (metres)."""
        cell = voxel * multiple
        low = [math.floor(x / cell + 1e-9) for x in lower]
        high = [max(math.ceil(x / cell - 1e-9), a + 1) for x, a in zip(upper, low, strict=True)]
        return cls(
            (low[0] * cell, low[1] * cell, low[2] * cell),
            voxel,
            tuple((h - a) * multiple for h, a in zip(high, low, strict=True)),  # type: ignore[arg-type]
        )

    def refined(self, n: int) -> VoxelGrid:
        """The same box with every voxel split into n^3."""
        x, y, z = self.shape
        return VoxelGrid(self.origin, self.voxel / n, (x * n, y * n, z * n))

    def block(self, low: Sequence[int], high: Sequence[int]) -> VoxelGrid:
        """The part of the grid from voxel ``low`` up to, not including, ``high``."""
        x, y, z = (o + int(a) * self.voxel for o, a in zip(self.origin, low, strict=True))
        nx, ny, nz = (int(b) - int(a) for a, b in zip(low, high, strict=True))
        return VoxelGrid((x, y, z), self.voxel, (nx, ny, nz))

    def centers(self) -> Tensor:
        """Voxel centres [X, Y, Z, 3] in metres."""
        axes = [
            o + (torch.arange(n, dtype=torch.float32) + 0.5) * self.voxel
            for o, n in zip(self.origin, self.shape, strict=True)
        ]
        return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)

    def to_index(self, points: Tensor) -> Tensor:
        """Continuous voxel coordinates [..., 3] of points [..., 3]; integers are voxel centres."""
        return (points - points.new_tensor(self.origin)) / self.voxel - 0.5

    def sample(self, volume: Tensor, points: Tensor, padding: str = "border") -> Tensor:
        """Trilinear samples [..., P, C] of volumes [..., C, X, Y, Z] here at points [..., P, 3].

        ``padding`` says what lies outside: "border" or "zeros" (as in `grid_sample`).
        """
        shape = points.new_tensor(self.shape)
        normalised = (self.to_index(points) + 0.5) * (2.0 / shape) - 1.0
        grid = normalised.flip(-1)  # grid_sample wants the last axis (z) first
        several = volume.reshape(-1, *volume.shape[-4:])
        out = _sample(several, grid.reshape(len(several), 1, 1, -1, 3), padding)
        return out[:, :, 0, 0].transpose(1, 2).reshape(*points.shape[:-1], -1)

    @property
    def world_T_index(self) -> Tensor:
        """[4, 4] from continuous voxel coordinates (integers at centres) to metres."""
        matrix = torch.eye(4, dtype=torch.float64)
        matrix[:3, :3] *= self.voxel
        matrix[:3, 3] = torch.tensor(self.origin, dtype=torch.float64) + 0.5 * self.voxel
        return matrix
