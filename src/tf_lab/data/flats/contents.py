"""What stands in a flat: a theme a room, and tall things that divide rooms and hide what is behind.

A divider stands with its short side at a wall and reaches into the room.
"""

from __future__ import annotations

import numpy as np

from tf_lab.data.flats.plan import FlatPlan
from tf_lab.data.rooms import furniture as f, storage as st
from tf_lab.data.rooms.arrange import THEMES, Maker, furnish
from tf_lab.data.rooms.decor import Kit, Piece
from tf_lab.data.rooms.footprint import Placed
from tf_lab.data.rooms.layout import Plan
from tf_lab.data.rooms.models import Furniture

Rng = np.random.Generator
HALL: tuple[Maker, ...] = (st.shelf, st.nightstand, f.plant)
TOPS = {"table": None, "coffee table": None, "desk": None, "sideboard": None, "counter": 0.9}
"""Pieces that people film from near, and the height (m) of their tops; None: their own."""


def furnish_room(
    kit: Kit, plan: FlatPlan, number: int, theme: str, furniture: Furniture | None = None
) -> list[Placed]:
    """Furnish one of the rooms; returns what stands on its floor."""
    room = plan.rooms[number]
    if number == plan.corridor:
        return furnish(kit, room, HALL, furniture=furniture)
    first = dividers(kit.rng, room, len(plan.rooms))
    return furnish(kit, room, THEMES[theme], first, furniture)


def dividers(rng: Rng, room: Plan, rooms: int) -> list[Piece]:
    """Partial walls, shelves and wardrobes that stand across a room; more where it is the only."""
    x0, y0, x1, y1 = room.rects[0]
    reach = 0.45 * min(x1 - x0, y1 - y0)
    area = (x1 - x0) * (y1 - y0)
    count = int(rng.integers(2, 5)) if rooms == 1 else int(rng.integers(0, 2 + (area > 12)))
    makers = (partial_wall, tall_shelf, wardrobe)
    return [makers[int(rng.integers(3))](rng, room.height, reach) for _ in range(count)]


def partial_wall(rng: Rng, height: float, reach: float) -> Piece:
    """A piece of wall, up to the ceiling or not."""
    thick, long = rng.uniform(0.1, 0.16), rng.uniform(0.5, 1.0) * min(reach, 1.8)
    high = height if rng.random() < 0.7 else rng.uniform(1.3, 2.0)

    def build(kit: Kit) -> None:
        role = "wall" if rng.random() < 0.7 else "accent"
        top = "z+" if high == height else ""
        # into the wall behind it: pieces stand a little off
        kit.s.box((0, -0.065, 0), (thick, long, high), kit.palette.index[role][0], skip=f"z- {top}")

    return Piece("partial wall", thick, long, high, build)


def tall_shelf(rng: Rng, height: float, reach: float) -> Piece:
    """A bookcase of more than eye height."""
    piece = st.shelf(rng)
    while piece.height < 1.7:
        piece = st.shelf(rng)
    return across(piece)


def wardrobe(rng: Rng, height: float, reach: float) -> Piece:
    """A wardrobe."""
    return across(st.wardrobe(rng))


def across(piece: Piece) -> Piece:
    """The piece with its side at the wall."""

    def build(kit: Kit) -> None:
        with kit.s.at((piece.depth, 0, 0), np.pi / 2):
            piece.build(kit)

    return Piece(piece.name, piece.depth, piece.width, piece.height, build)


def tops(placed: list[Placed]) -> list[tuple[Placed, float]]:
    """What of these pieces is filmed from near, and the height of its top (m)."""
    found = [(piece, TOPS[piece.name]) for piece in placed if piece.name in TOPS]
    return [(piece, piece.height if top is None else top) for piece, top in found]
