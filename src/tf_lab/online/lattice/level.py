"""One lattice of the reconstruction, coarse or fine: its voxels, view sets and features."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from tf_lab.network.tokens import Measurements
from tf_lab.online.frames import Frames
from tf_lab.online.lattice.blocks import HALF, Blocks, dilate, z_order
from tf_lab.online.lattice.table import Table
from tf_lab.online.views.store import ViewStore

BLOCK = 3  # voxels along a block's edge; a fine block is one coarse voxel
LATTICE = 0.05  # metres; voxel centres of both levels lie on multiples of it
FUSED = 1 << 19  # floats of tokens fused at a time on a CPU: more would not fit its cache

Box = tuple[np.ndarray, np.ndarray]  # lower and upper corner, metres


class Level:
    """Voxels of one size.

    Attributes:
        blocks: which voxels are allocated.
        store: their view sets.
        features: columns ``psi`` (fused) and ``refined`` [D], ``fused`` (ever), ``near`` (the
            surface), and those that users add.
        flags: by block: ``open`` (whether it is worked on at all) and what is out of date.

    Args:
        name: "coarse" or "fine".
        voxel: edge, metres.
        frames: what is measured in.
        store: empty.
        is_open: whether new blocks are open.
    """

    def __init__(
        self, name: str, voxel: float, frames: Frames, store: ViewStore, is_open: bool
    ) -> None:
        self.name, self.voxel, self.frames, self.store = name, voxel, frames, store
        self.device, self.network = frames.device, frames.network
        self.blocks = Blocks(BLOCK, self.device)
        width = self.network.config.width
        self.features = Table(self.device)
        for column in ("psi", "refined"):
            self.features.add_column(column, (width,), torch.float32, 0)
        for column in ("fused", "near"):
            self.features.add_column(column, (), torch.bool, 0)
        self.flags = Table(self.device)
        self.flags.add_column("open", (), torch.bool, is_open)
        for stage in ("refined", "near", "values"):
            self.flags.add_column(stage, (), torch.bool, 1)

    def allocate(self, block_coords: Tensor) -> None:
        """Make sure that the blocks at coordinates [P, 3] are there."""
        if self.blocks.allocate(block_coords):
            self.store.grow(self.blocks.rows)
            self.features.grow(self.blocks.rows)
            self.flags.grow(len(self.blocks))

    def points(self, rows: Tensor) -> Tensor:
        """Voxel centres [P, 3], metres."""
        return (self.blocks.voxels(rows).float() + 0.5) * self.voxel

    @property
    def active(self) -> Tensor:
        """Voxels with features, in open blocks: bool by row."""
        return self.features["fused"] & self.flags["open"].repeat_interleave(self.blocks.volume)

    def offer(self, frame: int, rows: Tensor) -> None:
        """Offer a frame's measurements to the voxels (rows [M]) that it sees: by logits alone."""
        logits = self.logits(rows, torch.full_like(rows, frame)) if self.store.heads else None
        self.store.add(frame, rows, self.keys(rows), logits, self.centers(frame, rows))

    def centers(self, frame: int, rows: Tensor) -> Tensor | None:
        """Cameras [M, K + 1, 3] of what rows [M] hold and of a new frame, relative to the voxels.

        Metres; anything where a slot is empty. None if the policy needs none.
        """
        if not self.store.policy.needs_centers:
            return None
        every = self.frames.cameras["world_T_cam"][:, :3, 3]
        held = every[self.store.frames[rows].long()]
        new = every[frame].expand(len(rows), 1, 3)
        return torch.cat([held, new], 1) - self.points(rows)[:, None]

    def logits(self, rows: Tensor, frames: Tensor) -> Tensor | None:
        """Selection logits [M, H] of frames [M] at rows [M]."""
        measured = self.frames.measure(self.name, self.points(rows), frames)
        return self.network.selection_logits(self.name, self.network.embed(self.name, measured))

    def keys(self, rows: Tensor) -> Tensor:
        """Lattice coordinates [M, 3] of the centres, which no two voxels of a level share."""
        steps = round(self.voxel / LATTICE)
        return self.blocks.voxels(rows) * steps + steps // 2

    def fuse(self, rows: Tensor, batch: int) -> tuple[Tensor, Tensor]:
        """Fused features [M, D] and view weights [M, K] of rows [M], at most ``batch`` at a time.

        Voxels with as many views are fused together, so that nobody waits for empty slots; where
        not all maps have room those near by, which mostly hold the same frames.
        """
        frames = self.store.frames
        count = (frames[rows] >= 0).sum(1)
        alike = z_order(self.blocks.voxels(rows)) if self.frames.crowded else count
        order = alike.argsort(stable=True)
        psi = torch.zeros(len(rows), self.features["psi"].shape[1], device=self.device)
        weights = torch.zeros(len(rows), frames.shape[1], device=self.device)
        if self.device.type == "cpu":
            batch = max(1, min(batch, FUSED // (frames.shape[1] * psi.shape[1])))
        starts = range(0, len(rows), batch)
        most = [count[order[start : start + batch]].amax() for start in starts]
        for start, slots in zip(starts, torch.stack(most).tolist() if most else [], strict=True):
            part, k = order[start : start + batch], max(1, slots)
            kept, filled = self.measurements(rows[part], k)
            tokens = self.network.embed_kept(self.name, kept)
            fused, w = self.network.fuse(self.name, tokens, filled, frames[rows[part], :k])
            psi[part], weights[part, :k] = fused.float(), w.float()
        return psi, weights

    def put(self, rows: Tensor, psi: Tensor) -> None:
        """Features [M, D] of rows [M], fused of the views that they hold now."""
        self.features["psi"][rows], self.features["fused"][rows] = psi, True
        self.store.dirty[rows] = False

    def measurements(self, rows: Tensor, slots: int) -> tuple[Measurements, Tensor]:
        """What the first slots of rows [M] hold, [M, slots, ...], and which are filled."""
        frames = self.store.frames[rows, :slots]
        filled = frames >= 0
        row, slot = filled.nonzero(as_tuple=True)
        found = self.frames.measure(self.name, self.points(rows[row]), frames[row, slot])
        kept = [part.new_zeros(*frames.shape, *part.shape[1:]) for part in found]
        for every, part in zip(kept, found, strict=True):
            every[row, slot] = part
        return Measurements(*kept), filled

    def blocks_in(self, box: Box | None) -> Tensor:
        """Which blocks a box touches: bool [blocks]."""
        if box is None:
            return torch.ones(len(self.blocks), dtype=torch.bool, device=self.device)
        edge = BLOCK * self.voxel
        low, high = (
            np.clip(np.floor(corner / edge + e), -HALF, HALF)  # a box may be infinite
            for corner, e in zip(box, (-1e-6, 1e-6), strict=True)
        )
        c = self.blocks.coords
        return (c >= c.new_tensor(low)).all(1) & (c <= c.new_tensor(high)).all(1)

    def pending(self, stage: str, box: Box | None) -> Tensor:
        """Numbers of the open blocks in a box for which a stage is out of date; told up to date."""
        found = self.blocks_in(box) & self.flags[stage] & self.flags["open"]
        numbers = found.nonzero().squeeze(1)
        self.flags[stage][numbers] = False
        return numbers

    def outdate(self, stage: str, coords: Tensor, voxels: int) -> None:
        """Say that a stage is out of date within so many voxels of blocks at ``coords`` [N, 3]."""
        near = self.around(coords, voxels)
        self.flags[stage][near] = True

    def around(self, coords: Tensor, voxels: int) -> Tensor:
        """Numbers of the blocks within so many voxels of the blocks at ``coords`` [N, 3]."""
        found = self.blocks.find(dilate(coords, math.ceil(voxels / BLOCK)))
        return found[found >= 0]
