"""What stands on the floor, and the free space that it leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, label

from tf_lab.data.rooms.layout import Plan

CELL = 0.05
LOW = 0.6
"""A camera may come nearer, by `REACH`, to pieces lower than this (m): it is held above them."""
REACH = 0.1


@dataclass(frozen=True)
class Placed:
    """A piece on the floor: corners [4, 2] of its footprint (counter-clockwise), height, name."""

    name: str
    corners: np.ndarray
    height: float

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Whether points [..., 2] lie on the footprint: bool [...]."""
        edges = np.roll(self.corners, -1, axis=0) - self.corners
        offset = points[..., None, :] - self.corners
        cross = edges[:, 0] * offset[..., 1] - edges[:, 1] * offset[..., 0]
        return np.all(cross >= 0, axis=-1)


def overlap(a: np.ndarray, b: np.ndarray, margin: float) -> bool:
    """Whether two rectangles [4, 2] come closer than ``margin`` (m; separating axes)."""
    for corners in (a, b):
        for axis in (corners[1] - corners[0], corners[2] - corners[1]):
            unit = axis / np.linalg.norm(axis)
            p, q = a @ unit, b @ unit
            if p.min() > q.max() + margin or q.min() > p.max() + margin:
                return False
    return True


class FreeSpace:
    """A grid of the floor with the camera's clearance (m) from walls and furniture."""

    def __init__(self, plan: Plan, placed: list[Placed]) -> None:
        rects = np.array(plan.rects)
        self.low = rects[:, :2].min(axis=0) - 0.1
        shape = np.ceil((rects[:, 2:].max(axis=0) + 0.1 - self.low) / CELL).astype(int)
        grid = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
        points = self.low + (grid + 0.5) * CELL
        free, low = plan.inside(points), np.zeros(tuple(shape), bool)
        for piece in placed:
            inside = piece.contains(points)
            if piece.height < LOW:
                low |= inside
            else:
                free &= ~inside
        self.clearance = distance_transform_edt(free) * CELL
        if low.any():
            beside = distance_transform_edt(~low) * CELL
            self.clearance = np.minimum(self.clearance, np.where(low, 0, beside + REACH))
        self._gradient = np.stack(np.gradient(self.clearance), axis=-1)

    def _index(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        index = np.floor((xy - self.low) / CELL).astype(int)
        index = np.clip(index, 0, np.array(self.clearance.shape) - 1)
        return index[..., 0], index[..., 1]

    def at(self, xy: np.ndarray) -> np.ndarray:
        """Clearance (m) at points [..., 2]."""
        return self.clearance[self._index(xy)]

    def uphill(self, xy: np.ndarray) -> np.ndarray:
        """Unit directions [..., 2] in which the clearance grows."""
        slope = self._gradient[self._index(xy)]
        return slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-6)

    def walkable(self, margin: float) -> np.ndarray:
        """The largest connected part with more than that clearance: bool like `clearance`."""
        parts, count = label(self.clearance > margin)
        if count == 0:
            return np.zeros(self.clearance.shape, bool)
        return parts == 1 + np.argmax(np.bincount(parts.ravel())[1:])
