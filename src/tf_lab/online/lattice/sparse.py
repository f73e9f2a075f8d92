"""The refinement networks on a list of active voxels instead of a dense volume.

`Refinement` multiplies by the active mask before every convolution, so inactive voxels never say
anything and are never read: convolving only the active ones gives the same features, at a cost
that follows the surface and not the box around it. (Submanifold convolutions, Graham & van der
Maaten 2017, are the same operation.)
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from tf_lab.network.refinement import ChannelNorm, ResidualBlock3d
from tf_lab.online.lattice.blocks import Blocks

GATHER = {"cpu": 1 << 19, "cuda": 1 << 27}  # floats gathered at a time


@dataclass
class Region:
    """Active voxels and who is beside whom.

    Attributes:
        rows: int64 [P], their rows in the level's tables.
        table: int64 [P, 27], positions in ``rows`` of the voxels around each, P where inactive.
    """

    rows: Tensor
    table: Tensor


def region(blocks: Blocks, numbers: Tensor, active: Tensor) -> Region:
    """The active voxels of blocks [N]; ``active`` is bool by row."""
    rows = blocks.rows_in(numbers)
    kept = active[rows]
    rows = rows[kept]
    position = torch.full((blocks.rows + 1,), len(rows), device=rows.device)
    position[rows] = torch.arange(len(rows), device=rows.device)
    around = blocks.neighbours(numbers).flatten(0, 1)[kept]
    return Region(rows, position[around])  # -1 is the last: never active


def convolve(conv: nn.Conv3d, x: Tensor, table: Tensor) -> Tensor:
    """A 3x3x3 (or 1x1x1) convolution of features [P, C] at the voxels of ``table`` [Q, 27]."""
    weight = conv.weight.permute(2, 3, 4, 1, 0).flatten(0, 3)  # [27 C, C']
    if conv.kernel_size[0] == 1:
        table = table[:, 13:14]
    x = F.pad(x, (0, 0, 0, 1))
    batch = max(1, GATHER.get(x.device.type, GATHER["cpu"]) // weight.shape[0])
    parts = (x.index_select(0, p.flatten()).view(len(p), len(weight)) for p in table.split(batch))
    out = [F.linear(features, weight.T, conv.bias) for features in parts]
    return torch.cat(out) if out else x.new_zeros(0, weight.shape[1])


def residual_blocks(blocks: nn.ModuleList, x: Tensor, table: Tensor) -> Tensor:
    """`ResidualBlock3d` one after the other on features [P, C]."""
    for block in blocks:
        assert isinstance(block, ResidualBlock3d)
        out = convolve(block.conv1, _normed(block.norm1, x), table)
        x = x + convolve(block.conv2, _normed(block.norm2, out), table)
    return x


def mask_logits(head: nn.Module, x: Tensor, table: Tensor) -> Tensor:
    """A mask head's logits [Q] at the voxels of ``table`` [Q, 27], from features [P, C]."""
    assert isinstance(head, nn.Sequential)
    first, _, last = head
    assert isinstance(first, nn.Conv3d) and isinstance(last, nn.Conv3d)
    hidden = F.relu(convolve(first, x, table))
    return F.linear(hidden, last.weight.flatten(1), last.bias).squeeze(1)


def _normed(norm: ChannelNorm, x: Tensor) -> Tensor:
    return F.relu(F.layer_norm(x, x.shape[1:], norm.weight, norm.bias, 1e-5))
