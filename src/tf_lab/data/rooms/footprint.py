"""What stands on the floor, and the free space that it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, label

from tf_lab.data.rooms.layout import Plan, Rect

CELL = 0.05
LOW = 0.6
"""A camera may come nearer, by `REACH`, to pieces lower than this (m): it is held above them."""
REACH = 0.1
EASE = 0.15
"""A camera may come nearer, by this (m), to the two sides of a passage."""


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

    def nearest(self, points: np.ndarray, inset: float) -> np.ndarray:
        """The points [N, 2] of the footprint, ``inset`` (m) from its edges, nearest to points."""
        origin, found = self.corners[0], np.zeros_like(points)
        for edge in (self.corners[1] - origin, self.corners[3] - origin):
            length = float(np.linalg.norm(edge))
            room = min(inset, length / 2)
            along = np.clip((points - origin) @ (edge / length), room, length - room)
            found += along[:, None] * (edge / length)
        return origin + found


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
    """A grid of the floor with the camera's clearance (m) from walls and furniture.

    Args:
        plan: the floor.
        placed: what stands on it.
        passages: where on the floor it leads through walls.
    """

    def __init__(self, plan: Plan, placed: Sequence[Placed], passages: Sequence[Rect] = ()) -> None:
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
        for x0, y0, x1, y1 in passages:
            near = ((points >= [x0 - 0.1, y0 - 0.1]) & (points <= [x1 + 0.1, y1 + 0.1])).all(-1)
            self.clearance = self.clearance + EASE * (near & free)
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

    def centres(self, mask: np.ndarray) -> np.ndarray:
        """The middles [N, 2] (m) of the cells of a mask."""
        return self.low + (np.argwhere(mask) + 0.5) * CELL

    def holds(self, mask: np.ndarray, xy: np.ndarray) -> bool:
        """Whether points [P, 2] all lie in a mask of the grid."""
        return bool(mask[self._index(xy)].all())

    def walkable(self, margin: float) -> np.ndarray:
        """The largest connected part with more than that clearance: bool like `clearance`."""
        parts, count = label(self.clearance > margin)
        if count == 0:
            return np.zeros(self.clearance.shape, bool)
        return parts == 1 + np.argmax(np.bincount(parts.ravel())[1:])
