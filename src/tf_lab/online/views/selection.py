"""Which views a voxel keeps when its K slots are full (paper, Sec. 3.4). Knows no model.

A policy says, of voxels that a new frame sees, which of the K measurements they hold and the new
one is to go.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import torch
import torch.nn.functional as F
from torch import Tensor


class Candidates(NamedTuple):
    """The K measurements that each of M voxels holds and, last, the new one.

    Attributes:
        seen: int64 [M], how many frames saw the voxel before this one.
        frames: int64 [M, K + 1], numbers of the frames.
        logits: [M, K + 1, H], first-block attention logits; None if the policy needs none.
        centers: [M, K + 1, 3], the cameras' centres relative to the voxel, metres; None likewise.
        chance: [M, K + 1] or, of the new one alone, [M, 1]: see `SelectionPolicy`; None likewise.
    """

    seen: Tensor
    frames: Tensor
    logits: Tensor | None = None
    centers: Tensor | None = None
    chance: Tensor | None = None


class SelectionPolicy(Protocol):
    """One signature for all policies: what they are made with is a seed, and their settings.

    Attributes:
        seed: of what is random.
        needs_logits, needs_centers, needs_chance: whether these of the candidates are read.
    """

    @property
    def seed(self) -> int: ...  # noqa: D102

    @property
    def needs_logits(self) -> bool: ...  # noqa: D102

    @property
    def needs_centers(self) -> bool: ...  # noqa: D102

    @property
    def needs_chance(self) -> bool: ...  # noqa: D102

    def chance(self, keys: Tensor, seen: Tensor, frames: Tensor) -> Tensor:
        """What is random of measurements, [M, N] or [M, n] if it is by ``seen`` alone.

        Not asked for unless needed. It is of the seed and these numbers alone, so that neither the
        order of the voxels matters nor whether frames come one by one.

        Args:
            keys: int64 [M, 3], the voxels' lattice coordinates.
            seen: int64 [M, n], n = N or 1: how many frames saw the voxel before.
            frames: int64 [M, N], numbers of the frames.
        """
        ...

    def drop(self, candidates: Candidates) -> Tensor:
        """Which of its K + 1 measurements each voxel gives up: int64 [M]; K is the new one.

        Only what is said of voxels whose slots are full counts.
        """
        ...


def slots(policy: SelectionPolicy, candidates: Candidates) -> Tensor:
    """The slot that the new measurement takes in each voxel, int64 [M]; -1: none.

    The first K measurements fill the slots in their order.
    """
    k = candidates.frames.shape[1] - 1
    slot = policy.drop(candidates)
    return torch.where(candidates.seen < k, candidates.seen, slot.masked_fill(slot == k, -1))


def without_logits(policy: SelectionPolicy) -> SelectionPolicy:
    """A policy for views that nothing ranks: random, of the same seed, if it needs a ranking."""
    return RandomSelection(policy.seed) if policy.needs_logits else policy


@dataclass(frozen=True)
class AttentionSelection:
    """Drop the measurement with the lowest weight, then add the new one (paper, Sec. 3.4)."""

    seed: int = 0
    needs_logits: ClassVar[bool] = True
    needs_centers: ClassVar[bool] = False
    needs_chance: ClassVar[bool] = False

    def chance(self, keys: Tensor, seen: Tensor, frames: Tensor) -> Tensor:
        """Nothing is."""
        raise NotImplementedError

    def drop(self, candidates: Candidates) -> Tensor:
        """See `SelectionPolicy`. Of equals the first goes."""
        assert candidates.logits is not None
        return _lowest_weight(candidates.logits[:, :-1])


@dataclass(frozen=True)
class RandomSelection:
    """A uniformly random subset of all frames that saw the voxel ("RND").

    Reservoir sampling (Vitter 1985, algorithm R) with counter-based random numbers: a draw is a
    function of (seed, voxel, count) alone, whatever the order in which voxels are processed.
    """

    seed: int = 0
    needs_logits: ClassVar[bool] = False
    needs_centers: ClassVar[bool] = False
    needs_chance: ClassVar[bool] = True

    def chance(self, keys: Tensor, seen: Tensor, frames: Tensor) -> Tensor:
        """Uniform integers float64 of 0..seen: the slot that a new measurement takes."""
        return (uniform(self.seed, keys[:, None], seen) * (seen + 1).double()).floor()

    def drop(self, candidates: Candidates) -> Tensor:
        """See `SelectionPolicy`."""
        assert candidates.chance is not None
        return candidates.chance[:, -1].long().clamp(max=candidates.frames.shape[1] - 1)


@dataclass(frozen=True)
class DiverseSelection:
    """Views drawn by their attention weights, others at every voxel (ours).

    Of the K + 1 measurements the one of the lowest score goes: its logit, plus a Gumbel variate:
    views are drawn without replacement by softmax weights (Gumbel top-k, Kool et al. 2019), which a
    smaller share of the logit tempers. The variates are hashed from (seed, voxel, frame):
    neighbouring voxels keep other views, and their 3D CNN meets more of them. The defaults were
    chosen on val flats, rooms and RedKitchen (docs/study.md). A share of the logarithm of the angle
    to the nearest other viewing direction may be added, for O(K^2) small products a voxel; on a val
    room it made no difference.

    Args:
        seed: of the variates.
        attention: share of the logits, averaged over heads; 0: none, 1: as weights are made.
        spread: share of the angle's logarithm; 0: none.
    """

    seed: int = 0
    attention: float = 1.0
    spread: float = 0.0
    needs_logits: ClassVar[bool] = True
    needs_chance: ClassVar[bool] = True

    @property
    def needs_centers(self) -> bool:
        """Only the angle needs them."""
        return self.spread > 0

    def chance(self, keys: Tensor, seen: Tensor, frames: Tensor) -> Tensor:
        """Standard Gumbel variates."""
        return gumbel(self.seed, keys, frames)

    def drop(self, candidates: Candidates) -> Tensor:
        """See `SelectionPolicy`."""
        _, _, logits, centers, chance = candidates
        assert logits is not None and chance is not None
        score = self.attention * logits.float().mean(-1) + chance
        if self.spread > 0:
            assert centers is not None
            score = score + self.spread * angle_to_nearest(centers).log()
        return score.argmin(dim=1)


def _lowest_weight(logits: Tensor) -> Tensor:
    """Which of its views [M, K, H] each voxel gives the lowest weight, of equals the first: [M].

    As `tf_lab.network.fusion.weights` has them, but for rounding. With the voxels last, which are
    many, a CPU takes a third of the time.
    """
    views_first = logits.flatten(1).T.contiguous().float().unflatten(0, logits.shape[1:])
    return torch.softmax(views_first, dim=0).mean(1).min(dim=0).indices


def gumbel(seed: int, keys: Tensor, frames: Tensor) -> Tensor:
    """Standard Gumbel variates float32 [M, K], hashed from seed, keys [M, 3] and frames [M, K]."""
    chance = uniform(seed, keys[:, None], frames).float()
    return -(-chance.clamp(1e-7, 1 - 1e-7).log()).log()


def angle_to_nearest(centers: Tensor) -> Tensor:
    """Angle (radians, a little more than 0) of each direction [..., K, 3] to the nearest other."""
    direction = F.normalize(centers, dim=-1)
    cosine = direction @ direction.transpose(-1, -2)
    itself = torch.eye(cosine.shape[-1], dtype=torch.bool, device=cosine.device)
    nearest = cosine.masked_fill(itself, -1).amax(-1)
    return torch.acos(nearest.clamp(-1, 1)) + 0.05


def uniform(seed: int, keys: Tensor, counter: Tensor) -> Tensor:
    """Uniform float64 [...] in [0, 1), hashed from seed, keys int64 [..., 3] and counter [...].

    Keys may be broadcast.
    """
    state = torch.full_like(keys[..., 0], seed)
    for word in (*keys.unbind(-1), counter):
        state = _mix(state ^ _mix(word + 0x632BE59B))
    return (state >> 11 & (1 << 52) - 1).double() / (1 << 52)


def _mix(x: Tensor) -> Tensor:
    """The finaliser of SplitMix64 (Steele et al. 2014) on int64, wrapping around."""
    x = x + -0x61C8864680B583EB
    x = (x ^ _shift(x, 30)) * -0x40A7B892E31B1A47
    x = (x ^ _shift(x, 27)) * -0x6B2FB644ECCEEE15
    return x ^ _shift(x, 31)


def _shift(x: Tensor, bits: int) -> Tensor:
    """Logical shift to the right of int64."""
    return (x >> bits) & ((1 << (64 - bits)) - 1)
