"""Floor plans of flats: one to five rooms, a corridor perhaps, and the passages between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tf_lab.data.rooms.layout import Opening, Plan, Rect, Wall, cut_openings

Rng = np.random.Generator
COUNTS = {1: 0.15, 2: 0.35, 3: 0.28, 4: 0.14, 5: 0.08}
"""How many rooms, a corridor included, and how often."""
CORNER = 0.3  # metres between a passage and the nearest corner


@dataclass(frozen=True)
class Passage:
    """An open doorway: the rooms (numbers) it joins, and its floor."""

    rooms: tuple[int, int]
    rect: Rect

    @property
    def centre(self) -> np.ndarray:
        """[2], metres."""
        x0, y0, x1, y1 = self.rect
        return np.array([x0 + x1, y0 + y1]) / 2


@dataclass(frozen=True)
class FlatPlan:
    """The rooms, each a plan in the flat's frame, which of them is a corridor, the passages."""

    rooms: tuple[Plan, ...]
    corridor: int | None
    passages: tuple[Passage, ...]

    @property
    def floor(self) -> Plan:
        """All that can be walked on, as one plan without walls."""
        rects = [rect for room in self.rooms for rect in room.rects]
        rects += [passage.rect for passage in self.passages]
        return Plan(tuple(rects), (), self.rooms[0].height)


def make_flat_plan(rng: Rng) -> FlatPlan:
    """A flat of 2.4-2.8 m height; rooms are rectangles, its outline is one, too."""
    count = int(rng.choice(list(COUNTS), p=list(COUNTS.values())))
    height, thickness = rng.uniform(2.4, 2.8), rng.uniform(0.12, 0.2)
    corridor = None
    if count >= 3 and rng.random() < 0.6:
        corridor, cells = 0, _along_a_corridor(rng, count)
    else:
        cells = _divided(rng, count)
    cells = _turned(rng, cells)
    rects = [_shrunk(cell, thickness / 2) for cell in cells]
    joined = _joined(rng, cells, corridor)
    passages = [_passage(rng, cells, pair, thickness) for pair in joined]
    high = rng.uniform(1.98, 2.1)
    outline = np.array(cells)
    outer = np.array([*outline[:, :2].min(axis=0), *outline[:, 2:].max(axis=0)])
    rooms = []
    for number, (cell, rect) in enumerate(zip(cells, rects, strict=True)):
        walls = _walls(rect)
        for passage in passages:
            if number in passage.rooms:
                walls = _pierced(walls, passage.rect, rect, thickness / 2, high)
        # side i of a rectangle (bottom, right, top, left) lies on the outline
        facade = [i for i, k in enumerate((1, 2, 3, 0)) if np.isclose(cell[k], outer[k])]
        kinds = ["door"] if number == corridor else _kinds(rng)
        if facade:
            walls = cut_openings(rng, walls, height, kinds, facade)
        rooms.append(Plan((rect,), walls, height))
    return FlatPlan(tuple(rooms), corridor, tuple(passages))


def _kinds(rng: Rng) -> list[str]:
    """What the outer walls of a room have."""
    kinds = ["window"] * int(rng.integers(1, 3))
    return [*kinds, *(kind for kind in ("niche", "door") if rng.random() < 0.3)]


def _divided(rng: Rng, count: int) -> list[Rect]:
    """A rectangle, halved across its longer side again and again: the largest part first."""
    area = rng.uniform(24, 34) if count == 1 else count * rng.uniform(10, 14)
    width = np.sqrt(area * rng.uniform(1.0, 1.5))
    cells: list[Rect] = [(0.0, 0.0, float(width), float(area / width))]
    while len(cells) < count:
        cells.sort(key=lambda c: (c[2] - c[0]) * (c[3] - c[1]))
        x0, y0, x1, y1 = cells.pop()
        length = max(x1 - x0, y1 - y0)
        at = float(np.clip(rng.uniform(0.38, 0.62) * length, 2.4, max(length - 2.4, 2.4)))
        if x1 - x0 >= y1 - y0:
            cells += [(x0, y0, x0 + at, y1), (x0 + at, y0, x1, y1)]
        else:
            cells += [(x0, y0, x1, y0 + at), (x0, y0 + at, x1, y1)]
    return cells


def _along_a_corridor(rng: Rng, count: int) -> list[Rect]:
    """The corridor first, and rooms on both of its sides."""
    above = count // 2
    sides = [count - 1 - above, above]
    width = max(sides) * rng.uniform(3.0, 3.9) + (0.8 if count == 3 else 0.0)
    low = rng.uniform(2.8, 4.2)
    high = low + rng.uniform(1.3, 1.65)
    top = high + rng.uniform(2.8, 4.2)
    cells: list[Rect] = [(0.0, float(low), float(width), float(high))]
    for rooms, y0, y1 in ((sides[0], 0.0, low), (sides[1], high, top)):
        share = rng.uniform(0.8, 1.2, rooms)
        edges = np.concatenate([[0.0], np.cumsum(share / share.sum())]) * width
        cells += [(float(edges[k]), y0, float(edges[k + 1]), float(y1)) for k in range(rooms)]
    return cells


def _turned(rng: Rng, cells: list[Rect]) -> list[Rect]:
    """The same, perhaps with x and y swapped."""
    return [(b, a, d, c) for a, b, c, d in cells] if rng.random() < 0.5 else cells


def _shrunk(cell: Rect, by: float) -> Rect:
    x0, y0, x1, y1 = cell
    return (x0 + by, y0 + by, x1 - by, y1 - by)


def _walls(rect: Rect) -> tuple[Wall, ...]:
    """Bottom, right, top and left, the room on their left."""
    x0, y0, x1, y1 = rect
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    pairs = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return tuple(Wall(a, b, ()) for a, b in pairs)


def _border(a: Rect, b: Rect) -> tuple[int, float, float, float] | None:
    """What two cells share, if a passage fits: the axis across it, where on that axis, from, to."""
    for axis in (0, 1):
        along = 1 - axis
        low, high = max(a[along], b[along]), min(a[along + 2], b[along + 2])
        if high - low < 1.0 + 2 * (CORNER + 0.1):
            continue
        for first, second in ((a, b), (b, a)):
            if np.isclose(first[axis + 2], second[axis]):
                return axis, second[axis], low, high
    return None


def _joined(rng: Rng, cells: list[Rect], corridor: int | None) -> list[tuple[int, int]]:
    """Pairs of rooms with a passage: all are connected, by the corridor first; a few loops."""
    pairs = [p for p in combinations(range(len(cells)), 2) if _border(cells[p[0]], cells[p[1]])]
    rng.shuffle(pairs)
    pairs.sort(key=lambda pair: corridor not in pair)
    group = list(range(len(cells)))
    chosen = []
    for a, b in pairs:
        if group[a] != group[b]:
            group = [group[a] if g == group[b] else g for g in group]
            chosen.append((a, b))
        elif rng.random() < 0.2:
            chosen.append((a, b))
    if len(set(group)) > 1:
        raise ValueError(f"rooms without a passage: {cells}")
    return chosen


def _passage(rng: Rng, cells: list[Rect], pair: tuple[int, int], thickness: float) -> Passage:
    border = _border(cells[pair[0]], cells[pair[1]])
    assert border is not None
    axis, at, low, high = border
    width, margin = rng.uniform(0.8, 1.0), CORNER + thickness / 2
    start = rng.uniform(low + margin, high - margin - width)
    across, along = (at - thickness / 2, at + thickness / 2), (start, start + width)
    x, y = (across, along) if axis == 0 else (along, across)
    return Passage(pair, (float(x[0]), float(y[0]), float(x[1]), float(y[1])))


def _pierced(
    walls: tuple[Wall, ...], hole: Rect, room: Rect, depth: float, high: float
) -> tuple[Wall, ...]:
    """The walls of a room with an opening to a passage that touches one of them."""
    # bottom, right, top, left: the passage ends where the room begins, and so on
    gaps = [hole[3] - room[1], hole[0] - room[2], hole[1] - room[3], hole[2] - room[0]]
    number = int(np.argmin(np.abs(gaps)))
    along, wall = number % 2, walls[number]
    start, end = sorted(abs(float(wall.a[along]) - hole[k]) for k in (along, along + 2))
    openings = [*wall.openings, Opening("passage", start, end, 0.0, high, depth)]
    pierced = replace(wall, openings=tuple(sorted(openings, key=lambda o: o.start)))
    return (*walls[:number], pierced, *walls[number + 1 :])
