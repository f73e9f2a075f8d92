"""The paper's literal procedure (Sec. 3.4), kept as the reference for tests and the benchmark.

Every voxel in the frustum is fused by the whole transformer at every frame, fine ones where the
coarse mask says "near-surface", and selection reads the weights of that fusion. One thing the paper
leaves open is done as in lazy fusion, and lazily: a coarse voxel that turns out to be near-surface
late gets its fine voxels' earlier views, too.
"""

from __future__ import annotations

import torch
from torch import Tensor

from tf_lab.online.lattice.level import Level
from tf_lab.online.reconstructor import Reconstructor


class EagerReconstructor(Reconstructor):
    """Fuses at every frame what `Reconstructor` fuses when it is asked for a mesh.

    Attributes:
        literal: False adds frames lazily for a while, which is quicker and comes to the same.
    """

    literal = True

    def see_coarse(self, frame: int, voxels: Tensor) -> None:
        """And bring the coarse level up to date."""
        super().see_coarse(frame, voxels)
        if self.literal:
            self.pipeline.update_coarse(None)

    def replay(self, coords: Tensor) -> None:
        """Lazily."""
        literal, self.literal = self.literal, False
        try:
            super().replay(coords)
        finally:
            self.literal = literal

    def offer(self, level: Level, frame: int, rows: Tensor) -> None:
        """And fuse all that the voxels hold then."""
        if not self.literal:
            super().offer(level, frame, rows)
            return
        is_open = level.flags["open"][torch.div(rows, level.blocks.volume, rounding_mode="floor")]
        level.offer(frame, rows[~is_open])  # nobody asks for what is no longer near a surface
        rows = rows[is_open]
        for part in rows.split(self.settings.batch):
            self._fuse_with(level, frame, part)
        if len(rows):
            self.pipeline.changed(level, rows)

    def _fuse_with(self, level: Level, frame: int, rows: Tensor) -> None:
        """Add a frame's measurement to voxels (rows [M]), and fuse all that they hold."""
        store = level.store
        # selection reads the logits of the fusion at the frame before, and the new measurement's
        level.offer(frame, rows)
        kept, filled = level.measurements(rows, store.views)
        tokens = self.network.embed_kept(level.name, kept)
        psi, _ = self.network.fuse(level.name, tokens, filled, store.frames[rows])
        if store.heads:
            tokens = self.network.embed(level.name, kept)
            logits = self.network.selection_logits(level.name, tokens)
            assert logits is not None
            store.logits[rows] = store.rounded(logits)
        level.put(rows, psi.float())
