"""The K measurements that every voxel keeps: frame indices and logits, no features.

A voxel takes 4 K bytes of frame indices, 2 K H bytes of logits and 5 of counters: 197 bytes at
K = 16 with the paper's 4 heads. float32 logits would take 325. Logits only rank the views of one
voxel, so a rounding by 1/2000 matters only between views that are all but equal: on a test room of
260 frames, 1 in 4000 of the views held is another one. ``float32`` is there to compare with.
"""

from __future__ import annotations

import torch
from torch import Tensor

from tf_lab.online.lattice.table import Table
from tf_lab.online.views.selection import Candidates, SelectionPolicy, slots


class ViewStore:
    """View sets of voxels, by row.

    Args:
        views: K.
        heads: H; 0 if the policy needs no logits.
        policy: decides what stays.
        device: where the store lives.
        logits: dtype in which they are kept.
    """

    def __init__(
        self,
        views: int,
        heads: int,
        policy: SelectionPolicy,
        device: torch.device | str = "cpu",
        logits: torch.dtype = torch.float16,
    ) -> None:
        self.views, self.heads, self.policy = views, heads, policy
        self.table = Table(torch.device(device))
        self.table.add_column("frames", (views,), torch.int32, -1)
        self.table.add_column("logits", (views, heads), logits, 0)
        self.table.add_column("seen", (), torch.int32, 0)
        self.table.add_column("dirty", (), torch.bool, 0)

    @property
    def frames(self) -> Tensor:
        """The frame in each slot: int32 [P, K], -1 where empty. Slots fill from the first."""
        return self.table["frames"]

    @property
    def logits(self) -> Tensor:
        """First-block attention logits [P, K, H] of the measurements."""
        return self.table["logits"]

    @property
    def seen(self) -> Tensor:
        """How many frames saw the voxel: int32 [P]."""
        return self.table["seen"]

    @property
    def dirty(self) -> Tensor:
        """Whether the view set changed since somebody cleared this: bool [P]."""
        return self.table["dirty"]

    @property
    def filled(self) -> Tensor:
        """Which slots hold a measurement: bool [P, K]."""
        return self.frames >= 0

    @property
    def nbytes(self) -> int:
        """Memory of all view sets."""
        return self.table.nbytes()

    def grow(self, rows: int) -> None:
        """Make room for voxels up to row ``rows``."""
        self.table.grow(rows)

    def rounded(self, logits: Tensor) -> Tensor:
        """Logits as the store tells them apart."""
        dtype = self.logits.dtype
        most = torch.finfo(dtype).max
        return logits.float().clamp(-most, most).to(dtype)

    def add(
        self,
        frame: int,
        rows: Tensor,
        keys: Tensor,
        logits: Tensor | None,
        centers: Tensor | None = None,
    ) -> Tensor:
        """Offer a new frame's measurements.

        Args:
            frame: its index.
            rows: int64 [M], the voxels it sees, each once.
            keys: int64 [M, 3], their lattice coordinates, the same at every call.
            logits: [M, H]; None if the policy needs none.
            centers: [M, K + 1, 3], see `Candidates`; None if the policy needs none.

        Returns:
            The slot that each took, int64 [M]; -1 where it was not kept.
        """
        slot = slots(self.policy, self.candidates(frame, rows, keys, logits, centers))
        self.put(frame, rows, slot, logits)
        return slot

    def candidates(
        self,
        frame: int,
        rows: Tensor,
        keys: Tensor,
        logits: Tensor | None,
        centers: Tensor | None,
    ) -> Candidates:
        """What a policy chooses among; arguments as of `add`."""
        frames = self.frames.new_full((len(rows), self.views + 1), frame, dtype=torch.int64)
        frames[:, :-1] = self.frames.index_select(0, rows)  # on a CPU faster than frames[rows]
        if logits is not None:
            both = self.logits.new_empty(len(rows), self.views + 1, self.heads)
            both[:, :-1], both[:, -1] = self.logits.index_select(0, rows), self.rounded(logits)
            logits = both  # no cat: under a bfloat16 autocast it takes no half precision
        seen = self.seen[rows].long()
        chance = None
        if self.policy.needs_chance:
            chance = self.policy.chance(keys, seen[:, None], frames)
        return Candidates(seen, frames, logits, centers, chance)

    def put(self, frame: int, rows: Tensor, slot: Tensor, logits: Tensor | None) -> None:
        """Write measurements [M] into slots [M] (-1: nowhere), and count them as seen."""
        kept = slot >= 0
        slot = slot.clamp(min=0)  # what isn't kept writes what is there: no list, no waiting for it
        self.seen[rows] += 1
        self.dirty[rows] |= kept
        self.frames[rows, slot] = torch.where(kept, frame, self.frames[rows, slot])
        if logits is not None:
            old = self.logits[rows, slot]
            self.logits[rows, slot] = torch.where(kept[:, None], self.rounded(logits), old)
