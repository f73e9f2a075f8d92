"""View selection in training: of all views of a voxel at once, what a policy would keep online."""

from __future__ import annotations

import torch
from torch import Tensor

from tf_lab.online.views.selection import Candidates, SelectionPolicy, without_logits


class BatchSelection:
    """Offers the views to a policy one after the other, as a view store does frame by frame.

    So training meets exactly what the test does, whatever the policy. Nothing waits for a GPU.

    Args:
        policy: decides what stays; random takes its place if it needs logits and there are none.
        views: K, how many views a voxel keeps.
        draws: int64 [B], of each chunk what makes its random choices its own; None: its number.
    """

    def __init__(self, policy: SelectionPolicy, views: int, draws: Tensor | None = None) -> None:
        self.policy, self.views, self.draws = policy, views, draws
        self.needs_logits = policy.needs_logits

    def __call__(
        self, logits: Tensor | None, valid: Tensor, centers: Tensor, keys: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The views that voxels keep.

        Args:
            logits: [P, V, H] selection logits; None if the policy needs none, or there are none.
            valid: bool [P, V], which views see the voxel.
            centers: [P, V, 3], the cameras' centres relative to the voxel, metres.
            keys: int64 [P, 3], which voxels they are; the first number is the chunk's, of B.

        Returns:
            Views int64 [P, K] (any where a slot is empty) and which slots are filled [P, K].
        """
        policy = self.policy if logits is not None else without_logits(self.policy)
        P, V = valid.shape
        k = min(self.views, V)
        order = torch.arange(V, device=valid.device)
        if self.draws is not None:
            keys = torch.cat([self.draws[keys[:, :1]], keys[:, 1:]], dim=1)
        seen = valid.cumsum(1) - valid.long()  # by views before
        # slot k, which nobody reads, takes what is not kept
        slot = torch.where(valid & (seen < k), seen, k)
        held = torch.zeros(P, k + 1, dtype=torch.int64, device=valid.device)
        frames = order.expand(P, V)
        held.scatter_(1, slot, frames)
        # all of it at once: hashing a view after the other takes a GPU ten times as many kernels
        chance = policy.chance(keys, seen, frames) if policy.needs_chance else None
        full = valid & (seen >= k)
        for view in range(k, V):
            held[:, k] = view
            candidates = Candidates(
                seen[:, view],
                held,
                None if logits is None else _taken(logits, held),
                _taken(centers, held) if policy.needs_centers else None,
                None if chance is None else chance.gather(1, held),
            )
            drop = torch.where(full[:, view], policy.drop(candidates), k)
            held.scatter_(1, drop[:, None], held[:, k:].clone())
        return held[:, :k], order[:k] < valid.sum(1, keepdim=True)


def _taken(values: Tensor, index: Tensor) -> Tensor:
    """Values [P, K, C] of views [P, K] out of [P, V, C]."""
    return torch.take_along_dim(values, index.unsqueeze(-1), dim=1)
