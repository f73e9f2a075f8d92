"""Which views a voxel keeps when its K slots are full (paper, Sec. 3.4). Knows no model.

A policy answers, for voxels that a new frame sees, which slot its measurement takes.
"""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from tf_lab.errors import TFLabError


class SelectionPolicy(Protocol):
    """One signature for all policies; ``needs_weights`` tells whether weights are looked at."""

    needs_weights: bool

    def slots(self, weights: Tensor, seen: Tensor, keys: Tensor) -> Tensor:
        """The slot [M] (int64) that the new measurement takes in each voxel; -1: none.

        Args:
            weights: [M, K] of the measurements held; only read where all slots are full.
            seen: int64 [M], how many frames saw the voxel before this one.
            keys: int64 [M, 3], the voxels' lattice coordinates, the same in every call.
        """
        ...


class AttentionSelection:
    """Drop the measurement with the lowest weight, then add the new one (paper, Sec. 3.4)."""

    needs_weights = True

    def slots(self, weights: Tensor, seen: Tensor, keys: Tensor) -> Tensor:
        """See `SelectionPolicy`. Ties drop the first."""
        return torch.where(seen < weights.shape[1], seen, weights.argmin(dim=1))


class RandomSelection:
    """A uniformly random subset of all frames that saw the voxel ("RND").

    Reservoir sampling (Vitter 1985, algorithm R) with counter-based random numbers: a draw is a
    function of (seed, voxel, count) alone, whatever the order in which voxels are processed.
    """

    needs_weights = False

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed

    def slots(self, weights: Tensor, seen: Tensor, keys: Tensor) -> Tensor:
        """See `SelectionPolicy`."""
        k = weights.shape[1]
        draw = self._uniform(keys, seen) * (seen + 1).double()
        slot = torch.where(draw < k, draw.long(), torch.full_like(seen, -1))
        return torch.where(seen < k, seen, slot)

    def _uniform(self, keys: Tensor, counter: Tensor) -> Tensor:
        """Uniform float64 [M] in [0, 1), hashed from seed, lattice coordinates and counter."""
        state = torch.full_like(counter, self.seed)
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


def make_policy(name: str, seed: int) -> SelectionPolicy:
    """The policy called "attention" or "random".

    Raises:
        TFLabError: another name.
    """
    if name == "attention":
        return AttentionSelection()
    if name == "random":
        return RandomSelection(seed)
    raise TFLabError(f"select.policy={name}: choose attention or random")
