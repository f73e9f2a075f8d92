"""Voxel grids."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from tf_lab.geometry.cameras import constants, grid_sample


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

    def centers(self, device: torch.device | None = None) -> Tensor:
        """Voxel centres [X, Y, Z, 3] in metres."""
        axes = [
            o + (torch.arange(n, dtype=torch.float32, device=device) + 0.5) * self.voxel
            for o, n in zip(self.origin, self.shape, strict=True)
        ]
        return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)

    def to_index(self, points: Tensor) -> Tensor:
        """Continuous voxel coordinates [..., 3] of points [..., 3]; integers are voxel centres."""
        return (points - constants(self.origin, points)) / self.voxel - 0.5

    def sample(self, volume: Tensor, points: Tensor, padding: str = "border") -> Tensor:
        """Trilinear samples [..., P, C] of volumes [..., C, X, Y, Z] here at points [..., P, 3].

        ``padding`` says what lies outside: "border" or "zeros" (as torch has them).
        """
        shape = constants(self.shape, points)
        normalised = (self.to_index(points) + 0.5) * (2.0 / shape) - 1.0
        grid = normalised.flip(-1)  # grid_sample wants the last axis (z) first
        several = volume.reshape(-1, *volume.shape[-4:])
        out = grid_sample(several, grid.reshape(len(several), 1, 1, -1, 3), padding)
        return out[:, :, 0, 0].transpose(1, 2).reshape(*points.shape[:-1], -1)

    @property
    def world_T_index(self) -> Tensor:
        """[4, 4] from continuous voxel coordinates (integers at centres) to metres."""
        matrix = torch.eye(4, dtype=torch.float64)
        matrix[:3, :3] *= self.voxel
        matrix[:3, 3] = torch.tensor(self.origin, dtype=torch.float64) + 0.5 * self.voxel
        return matrix
