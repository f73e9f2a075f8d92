"""Which frames paint a mesh: those that together see all of it."""

from __future__ import annotations

import numpy as np

FEW = 60  # frames: as many paint at least
LOOKS = 5  # frames that should see a voxel, of those that it holds
ENOUGH = 0.99  # of all these looks: the last of them take as many frames as the others together
VOXELS = 20_000  # that are looked at


def painters(held: np.ndarray, count: int) -> np.ndarray:
    """Frames to paint a surface by: numbers in 0..count-1, ascending.

    As many as there are up to `FEW`. Of more, one after the other that sees most of what too few of
    the chosen ones see (the greedy set cover), and evenly chosen ones if these are less than `FEW`.

    Args:
        held: int [V, K], frames that voxels of the surface hold, -1 in empty slots.
        count: of frames.
    """
    if count <= FEW:
        return np.arange(count)
    held = held[:: -(-len(held) // VOXELS) or 1]
    wanted = np.minimum((held >= 0).sum(1), LOOKS)
    chosen, left = np.zeros(count, bool), wanted.sum() * (1 - ENOUGH)
    while wanted.sum() > left:
        open_sets = held[wanted > 0]
        gains = np.bincount(open_sets[open_sets >= 0], minlength=count)
        best = int(np.where(chosen, 0, gains).argmax())
        chosen[best] = True
        wanted -= (held == best).any(1) & (wanted > 0)
    if chosen.sum() < FEW:
        chosen[np.linspace(0, count - 1, FEW).round().astype(int)] = True
    return np.flatnonzero(chosen)
