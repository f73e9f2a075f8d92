"""Spatial refinement by 3D CNNs, and the near-surface masks (paper, Sec. 3.2).

Normalisation is over the channels of each voxel, so that the result does not depend on the extent
of the volume: chunks in training and whole scenes at test time are treated alike.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class ChannelNorm(nn.Module):
    """Layer norm over the channels of [B, C, X, Y, Z], voxel by voxel."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(channels))
        self.bias = nn.Parameter(torch.zeros(channels))

    def forward(self, x: Tensor) -> Tensor:
        """[B, C, X, Y, Z] -> the same shape."""
        x = x.float()  # the gradient of rsqrt overflows float16 where a voxel's channels are alike
        variance, mean = torch.var_mean(x, dim=1, keepdim=True, correction=0)
        x = (x - mean) * torch.rsqrt(variance + 1e-5)
        return x * self.weight.view(-1, 1, 1, 1) + self.bias.view(-1, 1, 1, 1)


class ResidualBlock3d(nn.Module):
    """Two 3x3x3 convolutions with a residual connection, pre-activated."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm1, self.norm2 = ChannelNorm(channels), ChannelNorm(channels)
        self.conv1 = nn.Conv3d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv3d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor, active: Tensor) -> Tensor:
        """[B, C, X, Y, Z]; ``active`` [B, 1, X, Y, Z] of 0 and 1 keeps inactive voxels at zero."""
        out = self.conv1(F.relu(self.norm1(x)) * active)
        out = self.conv2(F.relu(self.norm2(out)) * active)
        return (x + out) * active


class Refinement(nn.Module):
    """C_c and C_f with the mask heads M_c and M_f.

    Args:
        width: D.
        blocks: residual blocks a level (3 in the paper); 0 is ``refine=false``: no 3D convolution
            anywhere, the mask heads look at one voxel only.
    """

    def __init__(self, width: int, blocks: int) -> None:
        super().__init__()
        self.coarse_blocks = nn.ModuleList(ResidualBlock3d(width) for _ in range(blocks))
        self.fine_blocks = nn.ModuleList(ResidualBlock3d(width) for _ in range(blocks))
        self.merge = nn.Conv3d(2 * width, width, 1)
        self.coarse_mask = _mask_head(width, 3 if blocks else 1)
        self.fine_mask = _mask_head(width, 3 if blocks else 1)

    def coarse(self, psi: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Refine coarse features [B, D, X, Y, Z].

        Args:
            psi: fused features, zero where unseen.
            seen: bool [B, X, Y, Z], voxels that some view sees.

        Returns:
            Refined features [B, D, X, Y, Z] and near-surface logits [B, X, Y, Z].
        """
        active = seen.unsqueeze(1).to(psi.dtype)
        for block in self.coarse_blocks:
            psi = block(psi, active)
        return psi, self.coarse_mask(psi).squeeze(1)

    def fine(self, coarse: Tensor, psi: Tensor, active: Tensor) -> tuple[Tensor, Tensor]:
        """Refine fine features, given the coarse ones of the same region.

        Args:
            coarse: refined coarse features [B, D, X, Y, Z].
            psi: fused fine features [B, D, 3X, 3Y, 3Z], zero where inactive.
            active: bool [B, 3X, 3Y, 3Z].

        Returns:
            Refined features [B, D, 3X, 3Y, 3Z] and near-surface logits [B, 3X, 3Y, 3Z].
        """
        mask = active.unsqueeze(1).to(psi.dtype)
        x = self.merge(torch.cat([upsample(coarse, first_axis=2), psi], dim=1)) * mask
        for block in self.fine_blocks:
            x = block(x, mask)
        return x, self.fine_mask(x).squeeze(1)


def upsample(volume: Tensor, first_axis: int) -> Tensor:
    """Nearest-neighbour upsampling by 3 of the three axes from ``first_axis`` on."""
    for axis in range(first_axis, first_axis + 3):
        volume = volume.repeat_interleave(3, dim=axis)
    return volume


def _mask_head(width: int, kernel: int) -> nn.Module:
    return nn.Sequential(
        nn.Conv3d(width, width, kernel, padding=kernel // 2), nn.ReLU(), nn.Conv3d(width, 1, 1)
    )
