"""Reconstructions whose networks run in full, on noise, and then find a known surface."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor, nn

from tf_lab.benchmarks.eager import EagerReconstructor
from tf_lab.online.decode import Decoder
from tf_lab.online.lattice.blocks import offsets
from tf_lab.online.lattice.level import Level
from tf_lab.online.pipeline import Pipeline
from tf_lab.online.reconstructor import Reconstructor


class KnownSurface(Pipeline):
    """Replaces what the networks say once they have said it.

    Attributes:
        solid: signed distances [P] (metres, positive in solid) of points [P, 3].
    """

    solid: Callable[[Tensor], Tensor]

    def near_rows(self, level: Level, numbers: Tensor, head: nn.Module) -> tuple[Tensor, Tensor]:
        """Those within a voxel of the surface."""
        rows, near = super().near_rows(level, numbers, head)
        if self.filter:
            near = self.solid(level.points(rows)).abs() < level.voxel
        return rows, near

    def decoded(self, decode: Decoder, numbers: Tensor, rows: Tensor) -> Tensor:
        """The distances at the samples."""
        values = super().decoded(decode, numbers, rows)
        inner = ((offsets(decode.n, rows.device) + 0.5) / decode.n - 0.5) * self.fine.voxel
        samples = self.fine.points(rows)[:, None] + inner
        return self.solid(samples.flatten(0, 1)).view_as(values)


class LazyOnKnownSurface(Reconstructor):
    """What is measured."""

    stages = KnownSurface


class EagerOnKnownSurface(EagerReconstructor):
    """What it is compared with."""

    stages = KnownSurface
