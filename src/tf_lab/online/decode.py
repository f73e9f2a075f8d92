"""Occupancy on the marching-cubes lattice of fine voxels, n^3 samples each.

`Network.decode` interpolates coarse and fine features at every sample and multiplies by the first
layer. Both are linear, so here the first layer comes first, once a voxel, and what is interpolated
is its output: the same logits, at 1/n^3 of that layer's cost.
"""

from __future__ import annotations

import torch
from torch import Tensor

from tf_lab.network.occupancy import OccupancyMLP


def interpolation(n: int, parts: int, device: torch.device) -> Tensor:
    """Trilinear weights of the 27 voxels around a voxel at samples within it.

    Args:
        n: samples along an edge of a part; the voxel's are ``n * parts``.
        parts: the voxel is cut in ``parts`` along every axis (3: fine voxels in a coarse one).
        device: of the result.

    Returns:
        [parts^3, n^3, 27], all indices x slowest.
    """
    at = (torch.arange(n * parts, device=device) + 0.5) / (n * parts) - 0.5
    line = torch.stack([(-at).clamp(min=0), 1 - at.abs(), at.clamp(min=0)], 1)
    line = line.view(parts, n, 3)
    weights = torch.einsum("aix,bjy,ckz->abcijkxyz", line, line, line)
    return weights.reshape(parts**3, n**3, 27)


class Decoder:
    """Decodes all samples of fine voxels.

    Args:
        mlp: the occupancy network.
        n: samples along a fine voxel's edge.
        batch: samples decoded at a time, which bounds the memory.
    """

    def __init__(self, mlp: OccupancyMLP, n: int, batch: int) -> None:
        self.mlp, self.n = mlp, n
        device = mlp.input.weight.device
        self.batch = max(1, batch // n**3)
        self.fine = interpolation(n, 1, device)[0]
        self.coarse = interpolation(n, 3, device)

    def __call__(
        self,
        coarse: Tensor,
        coarse_table: Tensor,
        part: Tensor,
        fine: Tensor,
        fine_table: Tensor,
    ) -> Tensor:
        """Occupancy logits [V, n^3].

        Args:
            coarse: refined features [Pc, D].
            coarse_table: int64 [V, 27], the coarse voxels around each fine voxel's, Pc if inactive.
            part: int64 [V], which of its coarse voxel's 27 parts each fine voxel is.
            fine: refined features [Pf, D].
            fine_table: int64 [V, 27], the voxels around each, Pf where inactive.
        """
        weight, width = self.mlp.input.weight, coarse.shape[1]
        first = [
            torch.nn.functional.pad(x @ w.T, (0, 0, 0, 1))
            for x, w in ((coarse, weight[:, :width]), (fine, weight[:, width:]))
        ]
        out = [
            self._decode(_rows(first[0], c), self.coarse[p], _rows(first[1], f))
            for c, p, f in zip(
                coarse_table.split(self.batch),
                part.split(self.batch),
                fine_table.split(self.batch),
                strict=True,
            )
        ]
        return torch.cat(out).float()

    def _decode(self, coarse: Tensor, weights: Tensor, fine: Tensor) -> Tensor:
        x = torch.baddbmm(self.mlp.input.bias, weights.to(coarse.dtype), coarse)
        x = x + self.fine.to(fine.dtype) @ fine
        return self.mlp.output(self.mlp.feed_forward(x)).squeeze(-1)


def _rows(values: Tensor, index: Tensor) -> Tensor:
    """Values [N, C] at an index [V, 27]: [V, 27, C]. On a CPU faster than ``values[index]``."""
    return values.index_select(0, index.flatten()).view(*index.shape, values.shape[1])
