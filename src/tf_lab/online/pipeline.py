"""From view sets to occupancy: every stage computes what is asked for and out of date, no more.

Five stages, coarse fusion, coarse refinement and mask, fine fusion, fine refinement and mask,
occupancy; each tells the next, by block, what it changed and how far that reaches. Asked for a box,
a stage asks the one before for the box and its own reach around it.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from tf_lab.geometry import COARSE, FINE
from tf_lab.network.network import Network
from tf_lab.online.decode import Decoder
from tf_lab.online.lattice import sparse
from tf_lab.online.lattice.blocks import offsets
from tf_lab.online.lattice.level import Box, Level

DECODED = {"cpu": 1 << 12, "cuda": 1 << 20}  # samples decoded at a time; on a CPU in its cache


def grown(box: Box | None, margin: float) -> Box | None:
    """A box with a margin (metres) on all sides."""
    return None if box is None else (box[0] - margin, box[1] + margin)


class Pipeline:
    """The stages behind a mesh.

    Args:
        network: in evaluation mode.
        coarse, fine: the levels, with their view sets.
        threshold: of both masks.
        n: occupancy samples along a fine voxel's edge.
        batch: voxels fused at a time.
        discover: called with the coordinates [N, 3] of coarse voxels that have become near-surface
            and have no fine voxels yet.
    """

    def __init__(
        self,
        network: Network,
        coarse: Level,
        fine: Level,
        threshold: float,
        n: int,
        batch: int,
        discover: Callable[[Tensor], None],
    ) -> None:
        self.network, self.coarse, self.fine = network, coarse, fine
        self.threshold, self.batch, self.discover = threshold, batch, discover
        self.filter = network.config.filter
        self.reach = 2 * len(network.refinement.coarse_blocks)  # voxels, of the 3D CNNs
        self.mask_reach = 1 if self.reach else 0
        device = coarse.device
        fine.features.add_column("values", (n**3,), torch.float32, -1)
        fine.features.add_column("shown", (), torch.bool, 0)
        samples = DECODED.get(device.type, DECODED["cpu"])
        self.decode = Decoder(network.occupancy, n, samples)
        self.centre = Decoder(network.occupancy, 1, samples)

    def update(self, box: Box | None, roughly: bool = False) -> Tensor:
        """Bring the occupancy in a box up to date; numbers of the fine blocks that were changed.

        Args:
            box: metres; None: everything.
            roughly: voxels around the box, which only the 3D CNNs read, stay as they are, new ones
                left out as beyond the border of a chunk in training. Once all are brought up to
                date nothing of that is left.
        """
        inner = box if roughly else None
        shown = grown(box, FINE * (3 if self.filter else 6))  # with what interpolation reads
        fused = grown(shown, FINE * self.reach)
        self.update_coarse(fused, inner)
        self.fuse(self.fine, fused, inner)
        self.refine_fine(shown)
        self.mask_fine(shown)
        return self.update_values(box)

    def update_coarse(self, box: Box | None, inner: Box | None = None) -> None:
        """Bring coarse features and mask in a box up to date, and open the fine level there."""
        refined = grown(box, COARSE * 2)
        self.fuse(self.coarse, grown(refined, COARSE * self.reach), inner)
        self.refine_coarse(refined)
        self.mask_coarse(box)

    def fuse(self, level: Level, box: Box | None, inner: Box | None = None) -> None:
        """Fuse the voxels in a box whose view set changed, of these those in ``inner`` if given."""
        rows = level.blocks.rows_in((level.blocks_in(box) & level.flags["open"]).nonzero()[:, 0])
        rows = rows[level.store.dirty[rows]]
        if inner is not None:
            blocks = torch.div(rows, level.blocks.volume, rounding_mode="floor")
            rows = rows[level.blocks_in(inner)[blocks]]
        if len(rows):
            level.put(rows, level.fuse(rows, self.batch)[0])
            self.changed(level, rows)

    def changed(self, level: Level, rows: Tensor) -> None:
        """Fused features at rows are others than before."""
        blocks = torch.unique(torch.div(rows, level.blocks.volume, rounding_mode="floor"))
        level.outdate("refined", level.blocks.coords[blocks], self.reach)

    def refine_coarse(self, box: Box | None) -> None:
        """Coarse 3D convolutions."""
        numbers = self.coarse.pending("refined", box)
        if not len(numbers):
            return
        domain = self._region(self.coarse, numbers, self.reach)
        x = self.coarse.features["psi"][domain.rows]
        x = sparse.residual_blocks(self.network.refinement.coarse_blocks, x, domain.table)
        rows = self._write(self.coarse, numbers, domain.rows, x)
        voxels = self.coarse.blocks.voxels(rows)  # a coarse voxel is a fine block
        self.fine.outdate("refined", voxels, self.reach)
        self.fine.outdate("values", voxels, 3 if self.filter else 4)

    def mask_coarse(self, box: Box | None) -> None:
        """Coarse near-surface mask; opens and closes fine blocks."""
        coarse, fine = self.coarse, self.fine
        numbers = coarse.pending("near", box)
        if not len(numbers):
            return
        rows, near = self.near_rows(coarse, numbers, self.network.refinement.coarse_mask)
        toggled = near != coarse.features["near"][rows]
        rows, near = rows[toggled], near[toggled]
        coarse.features["near"][rows] = near
        voxels = coarse.blocks.voxels(rows)
        new = voxels[near & (fine.blocks.find(voxels) < 0)]
        if len(new):
            fine.allocate(new)
            self.discover(new)
        numbers = fine.blocks.find(voxels)
        fine.flags["open"][numbers] = near
        for stage, reach in (("refined", self.reach), ("values", 1)):
            fine.outdate(stage, voxels, reach)
        self._close(numbers[~near])

    def _close(self, numbers: Tensor) -> None:
        """Nothing of these fine blocks is read any more."""
        rows = self.fine.blocks.rows_in(numbers)
        self.fine.features["refined"][rows] = 0
        self.fine.features["shown"][rows] = False

    def refine_fine(self, box: Box | None) -> None:
        """Fine 3D convolutions, on fused fine and refined coarse features."""
        fine, refinement = self.fine, self.network.refinement
        numbers = fine.pending("refined", box)
        if not len(numbers):
            return
        domain = self._region(fine, numbers, self.reach)
        blocks = torch.div(domain.rows, fine.blocks.volume, rounding_mode="floor")
        above = self.coarse.blocks.row_of(fine.blocks.coords[blocks])
        both = [self.coarse.features["refined"][above], fine.features["psi"][domain.rows]]
        merge = refinement.merge
        x = F.linear(torch.cat(both, 1), merge.weight.flatten(1), merge.bias)
        x = sparse.residual_blocks(refinement.fine_blocks, x, domain.table)
        self._write(fine, numbers, domain.rows, x)
        fine.outdate("values", fine.blocks.coords[numbers], 1)

    def mask_fine(self, box: Box | None) -> None:
        """Fine near-surface mask."""
        numbers = self.fine.pending("near", box)
        if len(numbers):
            rows, near = self.near_rows(self.fine, numbers, self.network.refinement.fine_mask)
            self.fine.features["near"][rows] = near

    def update_values(self, box: Box | None) -> Tensor:
        """Decode occupancy in the voxels that both masks leave."""
        fine = self.fine
        inside = fine.blocks_in(box) & fine.flags["values"]
        numbers = inside.nonzero().squeeze(1)
        fine.flags["values"][numbers] = False
        if not len(numbers):
            return numbers
        rows = fine.blocks.rows_in(numbers)
        shown = fine.active[rows] & fine.features["near"][rows]
        if not self.filter:
            shown &= self._crossing(numbers)
        fine.features["shown"][rows] = shown
        rows = rows[shown]
        if len(rows):
            fine.features["values"][rows] = self.decoded(self.decode, numbers, rows)
        return numbers

    def decoded(self, decode: Decoder, numbers: Tensor, rows: Tensor) -> Tensor:
        """Samples [V, n^3] of fine voxels ``rows`` [V] in blocks ``numbers``."""
        coarse, fine = self.coarse, self.fine
        domain = self._region(fine, numbers, 1)
        block = torch.div(rows, fine.blocks.volume, rounding_mode="floor")
        parents, parent = torch.unique(block, return_inverse=True)
        around = fine.blocks.coords[parents][:, None] + offsets(3, fine.device, -1)
        above = coarse.blocks.row_of(around)
        used, table = torch.unique(above, return_inverse=True)
        features = coarse.features["refined"][used.clamp(min=0)]
        features[used < 0] = 0
        return decode(
            features,
            table[parent],
            rows % fine.blocks.volume,
            fine.features["refined"][domain.rows],
            domain.table[self._positions(fine, domain.rows, rows)],
        )

    def _crossing(self, numbers: Tensor) -> Tensor:
        """Voxels of fine blocks within one voxel of a change of occupancy (``filter=false``).

        Without masks this finds the region worth decoding finely, after the multi-resolution
        extraction of Occupancy Networks (2019).
        """
        fine = self.fine
        near = fine.around(fine.blocks.coords[numbers], 1)
        domain = self._region(fine, near, 0)
        solid = torch.full((fine.blocks.rows + 1,), torch.nan, device=fine.device)
        solid[domain.rows] = (self.decoded(self.centre, near, domain.rows)[:, 0] > 0).float()
        around = solid[fine.blocks.neighbours(numbers).flatten(0, 1)]
        return (around == 1).any(1) & (around == 0).any(1)

    def near_rows(self, level: Level, numbers: Tensor, head: nn.Module) -> tuple[Tensor, Tensor]:
        """Active rows of blocks, and which of them are near a surface."""
        wanted = level.blocks.rows_in(numbers)
        wanted = wanted[level.active[wanted]]
        if not self.filter:
            return wanted, torch.ones_like(wanted, dtype=torch.bool)
        domain = self._region(level, numbers, self.mask_reach)
        table = domain.table[self._positions(level, domain.rows, wanted)]
        logits = sparse.mask_logits(head, level.features["refined"][domain.rows], table)
        return wanted, torch.sigmoid(logits.float()) > self.threshold

    def _region(self, level: Level, numbers: Tensor, reach: int) -> sparse.Region:
        """Active voxels of blocks and of those within reach (voxels)."""
        around = level.around(level.blocks.coords[numbers], reach)
        return sparse.region(level.blocks, around, level.active)

    def _positions(self, level: Level, domain: Tensor, rows: Tensor) -> Tensor:
        """Where ``rows`` stand in ``domain``."""
        position = torch.empty(level.blocks.rows, dtype=torch.int64, device=level.device)
        position[domain] = torch.arange(len(domain), device=level.device)
        return position[rows]

    def _write(self, level: Level, numbers: Tensor, rows: Tensor, x: Tensor) -> Tensor:
        """Keep refined features [P, D] of those rows [P] that lie in blocks; which these are."""
        inside = torch.zeros(len(level.blocks), dtype=torch.bool, device=level.device)
        inside[numbers] = True
        kept = inside[torch.div(rows, level.blocks.volume, rounding_mode="floor")]
        level.features["refined"][rows[kept]] = x[kept].float()
        level.outdate("near", level.blocks.coords[numbers], self.mask_reach)
        return rows[kept]
