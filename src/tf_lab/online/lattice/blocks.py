"""Voxels on an unbounded lattice, allocated in blocks: a sorted, growing index of block keys.

The lattice has its origin at the world's: voxel (i, j, k) of edge v has its centre at
``(ijk + 0.5) v``. Nothing needs to know how large the scene will be.
"""

from __future__ import annotations

import torch
from torch import Tensor

BITS = 21  # a coordinate's share of a 63-bit key: a million blocks either way
HALF = 1 << (BITS - 1)


def pack(coords: Tensor) -> Tensor:
    """Lattice coordinates int64 [..., 3] as int64 keys [...] that sort alike (x first)."""
    x, y, z = (coords + HALF).unbind(-1)
    return (x << 2 * BITS) | (y << BITS) | z


def unpack(keys: Tensor) -> Tensor:
    """The inverse of `pack`: int64 [...] -> [..., 3]."""
    mask = (1 << BITS) - 1
    return torch.stack([keys >> 2 * BITS, (keys >> BITS) & mask, keys & mask], -1) - HALF


def z_order(coords: Tensor) -> Tensor:
    """Keys int64 [P] along the Z-order curve (Morton 1966) of lattice coordinates int64 [P, 3].

    What is near by in space is mostly near by in this order.
    """
    coords = coords - coords.amin(0) if len(coords) else coords
    keys = torch.zeros(len(coords), dtype=torch.int64, device=coords.device)
    for bit in range(BITS):
        for axis, values in enumerate(coords.unbind(-1)):
            keys |= ((values >> bit) & 1) << (3 * bit + axis)
    return keys


def dilate(coords: Tensor, radius: int) -> Tensor:
    """All lattice points within ``radius`` along every axis of points [P, 3]: unique [Q, 3]."""
    steps = torch.arange(-radius, radius + 1, device=coords.device)
    for axis in range(3 if radius else 0):
        shift = torch.zeros(len(steps), 3, dtype=coords.dtype, device=coords.device)
        shift[:, axis] = steps
        coords = unpack(torch.unique(pack((coords[:, None] + shift).reshape(-1, 3))))
    return coords


def offsets(edge: int, device: torch.device, start: int = 0) -> Tensor:
    """The lattice points of a cube from (start, start, start), x slowest: int64 [edge^3, 3]."""
    axis = torch.arange(start, start + edge, device=device)
    return torch.cartesian_prod(axis, axis, axis)


def voxels_in(lower: Tensor, upper: Tensor, voxel: float, device: torch.device) -> Tensor:
    """Lattice coordinates int64 [P, 3] of all voxels that a box (metres) touches."""
    low, high = (lower / voxel - 1e-4).floor().long(), (upper / voxel + 1e-4).floor().long() + 1
    axes = zip(low.tolist(), high.tolist(), strict=True)
    return torch.cartesian_prod(*(torch.arange(a, b, device=device) for a, b in axes))


class Blocks:
    """Blocks of ``edge``^3 voxels, numbered in the order in which they were first seen.

    A voxel's row is ``block * edge^3 + place``; rows never change, so that tables can be appended
    to.

    Args:
        edge: voxels along a block's edge.
        device: where the index lives.
    """

    def __init__(self, edge: int, device: torch.device) -> None:
        self.edge, self.volume = edge, edge**3
        self._keys = torch.empty(0, dtype=torch.int64, device=device)  # sorted
        self._blocks = torch.empty(0, dtype=torch.int64, device=device)  # their numbers
        self.coords = torch.empty(0, 3, dtype=torch.int64, device=device)  # by number
        self._places = offsets(edge, device)
        self._around = self._neighbours_of_places()

    def __len__(self) -> int:
        return len(self.coords)

    @property
    def rows(self) -> int:
        """How many voxels are allocated."""
        return len(self) * self.volume

    @property
    def nbytes(self) -> int:
        """Memory of the index."""
        return self._keys.nbytes + self._blocks.nbytes + self.coords.nbytes

    def find(self, coords: Tensor) -> Tensor:
        """Numbers of blocks int64 [...] at block coordinates [..., 3]; -1 where there is none."""
        if not len(self):
            return torch.full(coords.shape[:-1], -1, device=coords.device)
        keys = pack(coords)
        place = torch.searchsorted(self._keys, keys).clamp_(max=len(self._keys) - 1)
        return torch.where(self._keys[place] == keys, self._blocks[place], -1)

    def allocate(self, coords: Tensor) -> int:
        """Add the blocks at coordinates [P, 3] that aren't there yet; how many were added."""
        missing = coords[self.find(coords) < 0]
        keys = torch.unique(pack(missing)) if len(missing) else missing[:, 0]
        if len(keys):
            numbers = torch.arange(len(keys), device=keys.device) + len(self)
            self.coords = torch.cat([self.coords, unpack(keys)])
            self._keys, order = torch.cat([self._keys, keys]).sort()
            self._blocks = torch.cat([self._blocks, numbers])[order]
        return len(keys)

    def block_of(self, voxels: Tensor) -> Tensor:
        """Block coordinates of voxels [..., 3]."""
        return torch.div(voxels, self.edge, rounding_mode="floor")

    def row_of(self, voxels: Tensor) -> Tensor:
        """Rows int64 [...] of voxels [..., 3]; -1 where their block isn't allocated."""
        block = self.block_of(voxels)
        x, y, z = (voxels - block * self.edge).unbind(-1)
        number = self.find(block)
        place = (x * self.edge + y) * self.edge + z
        return torch.where(number < 0, -1, number * self.volume + place)

    def voxels(self, rows: Tensor) -> Tensor:
        """Lattice coordinates [P, 3] of rows [P]."""
        numbers = torch.div(rows, self.volume, rounding_mode="floor")
        block = self.coords.index_select(0, numbers)  # on a CPU faster than coords[numbers]
        return block * self.edge + self._places.index_select(0, rows % self.volume)

    def rows_in(self, blocks: Tensor) -> Tensor:
        """All rows [N * edge^3] of blocks [N], block by block."""
        places = torch.arange(self.volume, device=blocks.device)
        return (blocks[:, None] * self.volume + places).flatten()

    def neighbours(self, blocks: Tensor) -> Tensor:
        """Rows [N, edge^3, 27] around every voxel of blocks [N], x slowest; -1: not allocated."""
        around = self.find(self.coords[blocks][:, None] + offsets(3, blocks.device, -1))  # [N, 27]
        block, place = self._around
        number = around[:, block]
        return torch.where(number < 0, -1, number * self.volume + place)

    def _neighbours_of_places(self) -> tuple[Tensor, Tensor]:
        """For every place in a block and offset: which block around it and place there [.., 27]."""
        near = self._places[:, None] + offsets(3, self._places.device, -1)
        step = torch.div(near, self.edge, rounding_mode="floor")
        place = near - step * self.edge
        weights = near.new_tensor([9, 3, 1])
        return ((step + 1) * weights).sum(-1), (
            place * near.new_tensor([self.edge**2, self.edge, 1])
        ).sum(-1)
