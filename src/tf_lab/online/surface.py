"""The mesh, chunk by chunk: only what changed is meshed again, and the parts fit without a seam.

All samples of a fine voxel are decoded together and kept, so neighbouring chunks see the same
values at their border and put the same vertices there; these are merged by their coordinates.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import torch
import trimesh
from torch import Tensor

from tf_lab.geometry import CHUNK, FINE, VoxelGrid
from tf_lab.meshes.isosurface import mesh_of
from tf_lab.meshes.weld import Part, weld
from tf_lab.online.lattice.blocks import offsets, pack, unpack
from tf_lab.online.lattice.level import BLOCK, Box, Level

EDGE = round(CHUNK / FINE)  # fine voxels along a chunk's edge
Chunk = tuple[int, int, int]


class Surface:
    """Meshes of chunks, in units of the marching-cubes lattice.

    Args:
        fine: with the columns ``values`` [n^3] (occupancy logits) and ``shown`` (decoded at all).
        n: samples along a fine voxel's edge.
    """

    def __init__(self, fine: Level, n: int) -> None:
        self.fine, self.n = fine, n
        self.dirty: set[Chunk] = set()
        self.parts: dict[Chunk, Part] = {}

    def touch(self, blocks: Tensor) -> None:
        """Fine blocks (numbers [N]) have other values than before."""
        per_chunk = EDGE // BLOCK
        coords = self.fine.blocks.coords[blocks]
        # A chunk reads one voxel beyond its upper faces.
        reads = torch.stack([coords, coords - 1])
        self.dirty |= spanned(torch.div(reads, per_chunk, rounding_mode="floor"))

    def update(self, box: Box | None) -> int:
        """Mesh the dirty chunks that a box touches again; how many these were."""
        todo = [chunk for chunk in sorted(self.dirty) if _touches(chunk, box)]
        for chunk in todo:
            self.parts.pop(chunk, None)
            part = self._mesh(chunk)
            if len(part.faces):
                self.parts[chunk] = (np.asarray(part.vertices), np.asarray(part.faces))
        self.dirty.difference_update(todo)
        return len(todo)

    def assemble(self, box: Box | None) -> trimesh.Trimesh:
        """The chunks that a box touches as one mesh, metres."""
        chosen = [chunk for chunk in sorted(self.parts) if _touches(chunk, box)]
        if not chosen:
            return trimesh.Trimesh()
        vertices, faces = weld([self.parts[chunk] for chunk in chosen], borders=EDGE * self.n)
        return trimesh.Trimesh((vertices + 0.5) * (FINE / self.n), faces, process=False)

    def _mesh(self, chunk: Chunk) -> trimesh.Trimesh:
        """Cells whose lower corner lies in a chunk."""
        fine, n = self.fine, self.n
        corner = torch.tensor(chunk, device=fine.device) * EDGE
        rows = fine.blocks.row_of(corner + offsets(EDGE + 1, fine.device))
        shown = (rows >= 0) & fine.features["shown"][rows]
        if not shown.any():
            return trimesh.Trimesh()
        values = fine.features["values"].new_full((len(rows), n**3), -1.0)
        values[shown] = fine.features["values"][rows[shown]]
        side, most = EDGE + 1, EDGE * n + 1
        field = values.view(side, side, side, n, n, n).permute(0, 3, 1, 4, 2, 5)
        field = field.reshape(side * n, side * n, side * n)[:most, :most, :most].cpu()
        mask = shown.view(side, side, side).cpu()
        for axis in range(3):
            mask = mask.repeat_interleave(n, dim=axis)
        mask = mask[:most, :most, :most]
        x, y, z = (c * EDGE * n - 0.5 for c in chunk)
        return mesh_of(field, mask, VoxelGrid((x, y, z), 1.0, (most, most, most)))


def spanned(corners: Tensor) -> set[Chunk]:
    """The chunks that boxes touch, two along an axis at most, by those of their corners [2, N, 3].

    The corners are lower and upper, in any order.
    """
    lower, upper = (pack(corner) for corner in corners)
    pairs = torch.unique(torch.stack([lower, upper], 1)[lower != upper], dim=0)
    ends = unpack(pairs).unbind(1)
    mixed = [
        torch.stack([ends[c][:, axis] for axis, c in enumerate(choice)], 1)
        for choice in product((0, 1), repeat=3)
    ]
    keys = torch.unique(torch.cat([pack(torch.cat(mixed)), lower]))
    return {(x, y, z) for x, y, z in unpack(keys).tolist()}


def whole_chunks(box: Box | None) -> Box | None:
    """The chunks that a box (metres) touches, with the voxel that they read beyond themselves."""
    if box is None:
        return None
    low, high = np.ceil(box[0] / CHUNK - 1 - 1e-9), np.floor(box[1] / CHUNK + 1e-9) + 1
    return low * CHUNK, high * CHUNK + FINE


def _touches(chunk: Chunk, box: Box | None) -> bool:
    if box is None:
        return True
    low = np.array(chunk) * CHUNK
    return bool((low <= box[1] + 1e-9).all() and (low + CHUNK >= box[0] - 1e-9).all())
