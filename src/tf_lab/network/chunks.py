"""What a training step gives the network, and what the network says of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor


@dataclass(frozen=True)
class Views:
    """The views of a batch of chunks, in the chunks' frames.

    Attributes:
        images: [B, V, 3, H, W], 0..255.
        K: [B, V, 3, 3].
        world_T_cam: [B, V, 4, 4], camera to chunk.
        times: int64 [B, V], numbers that grow with time; None: as the views are ordered.
        maps: their feature maps [B * V, C, h, w] by level, where they are known.
        stereo: their depth maps [B, V, 2, h, w] (`tf_lab.stereo.depth`), if the network is told.
    """

    images: Tensor
    K: Tensor
    world_T_cam: Tensor
    times: Tensor | None = None
    maps: Mapping[str, Tensor] | None = None
    stereo: Tensor | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the images."""
        return self.images.shape[-1], self.images.shape[-2]


class KeepViews(Protocol):
    """Chooses which of their V views voxels keep in training."""

    needs_logits: bool

    def __call__(
        self, logits: Tensor | None, valid: Tensor, centers: Tensor, keys: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Views int64 [P, K_t], and which of these slots are filled, bool [P, K_t].

        Args:
            logits: [P, V, H] of selection; None if it needs none, or nothing ranks views.
            valid: bool [P, V], which views see the voxel.
            centers: [P, V, 3], the cameras' centres relative to the voxel, metres.
            keys: int64 [P, 3], which voxels they are: chunk of the batch, voxel of it, level.
        """
        ...


@dataclass
class Predictions:
    """What training compares with the ground truth.

    Attributes:
        coarse: near-surface logits [B, X, Y, Z] and ``coarse_seen`` bool, where some view sees.
        fine: near-surface logits [B, 3X', 3Y', 3Z'] and ``fine_active`` bool, where computed.
        occupancy: logits [B, P] and ``seen`` bool, where some view sees the point.
    """

    coarse: Tensor
    coarse_seen: Tensor
    fine: Tensor
    fine_active: Tensor
    occupancy: Tensor
    seen: Tensor
