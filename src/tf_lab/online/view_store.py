"""The K measurements that every voxel keeps: frame indices and logits, no features."""

from __future__ import annotations

import torch
from torch import Tensor

from tf_lab.network.fusion.weights import weights_from_logits
from tf_lab.online.selection import SelectionPolicy


class ViewStore:
    """View sets of P voxels.

    Attributes:
        frames: int32 [P, K], the frame in each slot; -1 where empty.
        logits: float32 [P, K, H], its first-block attention logits.
        seen: int64 [P], how many frames saw the voxel.

    Args:
        keys: int64 [P, 3], lattice coordinates of the voxels.
        views: K.
        heads: H; 0 if the policy needs no weights.
        policy: decides what stays.
    """

    def __init__(self, keys: Tensor, views: int, heads: int, policy: SelectionPolicy) -> None:
        self.keys, self.policy = keys, policy
        self.frames = torch.full((len(keys), views), -1, dtype=torch.int32, device=keys.device)
        self.logits = torch.zeros(len(keys), views, heads, device=keys.device)
        self.seen = torch.zeros(len(keys), dtype=torch.int64, device=keys.device)

    @property
    def filled(self) -> Tensor:
        """Which slots hold a measurement: bool [P, K]."""
        return self.frames >= 0

    def add(self, frame: int, voxels: Tensor, logits: Tensor | None) -> None:
        """Offer a new frame's measurements.

        Args:
            frame: its index.
            voxels: int64 [M], the voxels it sees, each once.
            logits: [M, H]; None if the policy needs no weights.
        """
        seen = self.seen[voxels]
        if self.policy.needs_weights:
            weights = weights_from_logits(self.logits[voxels], None)  # read where full only
        else:
            weights = self.logits.new_zeros(len(voxels), self.frames.shape[1])
        slot = self.policy.slots(weights, seen, self.keys[voxels])
        self.seen[voxels] += 1
        kept = slot >= 0
        voxels, slot = voxels[kept], slot[kept]
        self.frames[voxels, slot] = frame
        if logits is not None:
            self.logits[voxels, slot] = logits[kept].float()
