"""The shell of a room: floor plan, walls with doors, windows and alcoves as real recesses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tf_lab.data.rooms.materials import Palette
from tf_lab.data.rooms.shapes import Surfaces
from tf_lab.data.rooms.textures import colour

Rng = np.random.Generator
Rect = tuple[float, float, float, float]
"""x0, y0, x1, y1 in metres."""


@dataclass(frozen=True)
class Opening:
    """An opening of a wall; extent along and up the wall (m).

    ``kind`` door (closed), window and niche are recesses; a passage leads to the next room: each of
    the two rooms has one, half as deep as the wall between them.
    """

    kind: str
    start: float
    end: float
    low: float
    high: float
    depth: float


@dataclass(frozen=True)
class Wall:
    """A wall from corner ``a`` to ``b`` with the room on its left; ``yaw`` turns +x along it."""

    a: np.ndarray
    b: np.ndarray
    openings: tuple[Opening, ...]

    @property
    def length(self) -> float:
        """Metres."""
        return float(np.linalg.norm(self.b - self.a))

    @property
    def yaw(self) -> float:
        """Radians; +y of the wall's frame then points into the room."""
        return float(np.arctan2(*(self.b - self.a)[::-1]))


@dataclass(frozen=True)
class Plan:
    """A floor plan: axis-aligned rectangles whose union is the floor, the outline, the height."""

    rects: tuple[Rect, ...]
    walls: tuple[Wall, ...]
    height: float

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Whether points [..., 2] lie on the floor: bool [...]."""
        x, y = points[..., 0], points[..., 1]
        hits = [(x >= a) & (y >= b) & (x <= c) & (y <= d) for a, b, c, d in self.rects]
        return np.any(hits, axis=0)


def make_plan(rng: Rng) -> Plan:
    """A box or an L of 3.2-6 m by 3-5 m, 2.4-3 m high, with a door and other openings."""
    width, depth, height = rng.uniform(3.2, 6.0), rng.uniform(3.0, 5.0), rng.uniform(2.4, 3.0)
    corners = np.array([[0, 0], [width, 0], [width, depth], [0, depth]])
    rects: tuple[Rect, ...] = ((0.0, 0.0, width, depth),)
    if width > 4.0 and depth > 3.6 and rng.random() < 0.5:
        cut = np.array(
            [width - rng.uniform(1.0, width - 2.6), depth - rng.uniform(0.9, depth - 2.4)]
        )
        corners = np.array(
            [[0, 0], [width, 0], [width, cut[1]], [cut[0], cut[1]], [cut[0], depth], [0, depth]]
        )
        rects = ((0.0, 0.0, width, float(cut[1])), (0.0, 0.0, float(cut[0]), depth))
    turned = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    walls = [Wall(a, b, ()) for a, b in turned]
    kinds = ["door", "window", "window", "niche", "door"]
    kinds = kinds[: int(rng.integers(3, 6))]
    return Plan(rects, cut_openings(rng, walls, height, kinds, range(len(walls))), height)


def cut_openings(
    rng: Rng, walls: Sequence[Wall], height: float, kinds: Sequence[str], where: Sequence[int]
) -> tuple[Wall, ...]:
    """The walls; those of number ``where`` get openings of these kinds that find room."""
    found = [list(wall.openings) for wall in walls]
    for kind in kinds:
        for _ in range(12):
            i = where[int(rng.integers(len(where)))]
            opening = _opening(rng, kind, walls[i].length, height)
            gaps = [o.start - opening.end > 0.3 or opening.start - o.end > 0.3 for o in found[i]]
            if opening.start > 0.35 and all(gaps):
                found[i].append(opening)
                break
    return tuple(
        replace(wall, openings=tuple(sorted(openings, key=lambda o: o.start)))
        for wall, openings in zip(walls, found, strict=True)
    )


def _opening(rng: Rng, kind: str, length: float, height: float) -> Opening:
    """An opening somewhere on a wall of that length; it starts below 0 where it has no room."""
    if kind == "door":
        width, low, high, depth = rng.uniform(0.8, 1.0), 0.0, rng.uniform(1.98, 2.1), 0.1
    elif kind == "window":
        width, low, depth = rng.uniform(0.8, 1.9), rng.uniform(0.75, 1.05), rng.uniform(0.12, 0.25)
        high = min(low + rng.uniform(0.9, 1.4), height - 0.2)
    else:
        width, low, depth = (
            rng.uniform(0.6, 1.3),
            rng.choice([0.0, 0.5, 0.8]),
            rng.uniform(0.2, 0.4),
        )
        high = low + rng.uniform(0.7, 1.2) if low else rng.uniform(1.8, 2.2)
    room = length - width - 0.8
    start = 0.4 + rng.uniform(0, room) if room > 0 else -1.0
    return Opening(kind, start, start + width, float(low), float(high), depth)


def build_shell(surfaces: Surfaces, plan: Plan, palette: Palette, rng: Rng) -> None:
    """Floor, ceiling and walls with everything that is fixed to them."""
    trim = palette.index["painted"][0]
    tint = rng.uniform(0.7, 1.1) * np.ones(3) if rng.random() < 0.6 else colour(rng, 0.6)
    outline = np.array([wall.a for wall in plan.walls])
    fan = [(0, 1, 2), (0, 2, 3)]
    if len(outline) == 6:  # the L: fan from the reflex corner
        fan = [(3, 4, 5), (3, 5, 0), (3, 0, 1), (3, 1, 2)]
    floor = np.column_stack([outline, np.zeros(len(outline))])
    turn = rng.choice([0, np.pi / 2, 0.6])
    along = (np.cos(turn), np.sin(turn), 0.0)
    surfaces.polygon(floor, palette.index["floor"][0], u_axis=along, triangles=fan)
    last = len(floor) - 1
    ceiling = floor[::-1] + np.array([0, 0, plan.height])
    flipped = [(last - a, last - c, last - b) for a, b, c in fan]
    surfaces.polygon(ceiling, palette.index["ceiling"][0], triangles=flipped)
    accent = rng.choice(len(plan.walls), int(rng.integers(1, 3)), replace=False)
    for i, wall in enumerate(plan.walls):
        material = palette.index["accent" if i in accent else "wall"][0]
        with surfaces.at((*wall.a, 0), wall.yaw):
            _wall(surfaces, wall, plan.height, material)
            _skirting(surfaces, wall, trim, tint)
            for opening in wall.openings:
                _fill(surfaces, opening, palette, rng, tint)


def _quad(surfaces: Surfaces, span: Rect, material: int, uv: np.ndarray) -> None:
    """A piece x0, z0, x1, z1 of a wall; pieces with the same ``uv`` at the origin continue."""
    x0, z0, x1, z1 = span
    corners = np.array([[x1, 0, z0], [x0, 0, z0], [x0, 0, z1], [x1, 0, z1]])
    start = uv + np.array([x1, -z0])
    surfaces.polygon(corners, material, u_axis=(1, 0, 0), uv_start=start)


def _wall(surfaces: Surfaces, wall: Wall, height: float, material: int) -> None:
    """The wall's face around its openings (in the wall's frame: room at y > 0)."""
    edge, uv = 0.0, surfaces.rng.uniform(0, 8, 2)
    for o in wall.openings:
        _quad(surfaces, (edge, 0, o.start, height), material, uv)
        _quad(surfaces, (o.start, o.high, o.end, height), material, uv)
        if o.low > 0:
            _quad(surfaces, (o.start, 0, o.end, o.low), material, uv)
        edge = o.end
    _quad(surfaces, (edge, 0, wall.length, height), material, uv)


def _skirting(surfaces: Surfaces, wall: Wall, material: int, tint: np.ndarray) -> None:
    edge = 0.0
    stops = [(o.start, o.end) for o in wall.openings if o.low == 0]
    for start, end in [*stops, (wall.length, 0.0)]:
        surfaces.box((edge, 0.0, 0), (start, 0.015, 0.08), material, tint, skip="z- y-")
        edge = end


def _fill(s: Surfaces, o: Opening, palette: Palette, rng: Rng, tint: np.ndarray) -> None:
    """The recess itself (its five inner sides) and what stands in it."""
    painted = palette.index["painted"][0]
    d, x0, x1, z0, z1 = -o.depth, o.start, o.end, o.low, o.high
    sides = [
        [[x0, d, z0], [x0, 0, z0], [x0, 0, z1], [x0, d, z1]],
        [[x1, 0, z0], [x1, d, z0], [x1, d, z1], [x1, 0, z1]],
        [[x0, 0, z1], [x1, 0, z1], [x1, d, z1], [x0, d, z1]],
        [[x0, d, z0], [x1, d, z0], [x1, 0, z0], [x0, 0, z0]],
    ]
    for side in sides:
        corners = np.array(side)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
        centre = np.array([(x0 + x1) / 2, d / 2, (z0 + z1) / 2])
        inward = normal @ (centre - corners[0]) > 0
        s.polygon(corners if inward else corners[::-1], painted)
    if o.kind == "passage":
        _casing(s, o, painted, tint)
        return
    back = "accent" if o.kind == "niche" else "outside" if o.kind == "window" else "painted"
    corners = np.array([[x1, d, z0], [x0, d, z0], [x0, d, z1], [x1, d, z1]])
    glow = rng.uniform(0.4, 1.0) if o.kind == "window" else 0.0
    dim = 0.55 if o.kind == "window" else 1.0  # so bright already by the window's own light
    s.polygon(corners, palette.index[back][0], dim * np.ones(3), glow, u_axis=(1, 0, 0))
    if o.kind == "window":
        _window_frame(s, o, painted, rng, tint)
    elif o.kind == "door":
        _door(s, o, palette, rng, tint)


def _window_frame(s: Surfaces, o: Opening, material: int, rng: Rng, tint: np.ndarray) -> None:
    """Bars across the pane, and a sill that stands out into the room."""
    w, y0, y1 = 0.05, -o.depth + 0.005, -o.depth + 0.055
    bars = int(rng.integers(2, 4)) if o.end - o.start > 1.0 else 2
    for x in np.linspace(o.start, o.end - w, bars + int(rng.random() < 0.5)):
        s.box((x, y0, o.low), (x + w, y1, o.high), material, tint, skip="y-")
    for z in (o.low, o.high - w):
        s.box((o.start, y0, z), (o.end, y1 - 0.008, z + w), material, tint, skip="y- x- x+")
    s.box((o.start - 0.06, 0, o.low - 0.035), (o.end + 0.06, 0.11, o.low - 0.004), material, tint)


def _door(s: Surfaces, o: Opening, palette: Palette, rng: Rng, tint: np.ndarray) -> None:
    """A leaf with raised panels, a handle and a frame around the opening."""
    x0, x1, high, d = o.start, o.end, o.high, -o.depth
    leaf = palette.pick("wood", rng) if rng.random() < 0.6 else palette.index["painted"][0]
    s.box((x0 + 0.01, d + 0.01, 0), (x1 - 0.01, d + 0.05, high - 0.01), leaf, skip="z- y-")
    rows = int(rng.integers(1, 4))
    edges = np.linspace(0.12, high - 0.06, rows + 1)
    for low, top in pairwise(edges):
        size = (x0 + 0.13, d + 0.05, low), (x1 - 0.13, d + 0.065, top - 0.07)
        s.box(*size, leaf, 0.85 * np.ones(3), skip="y-")
    metal, knob = palette.index["painted"][0], x1 - 0.09
    s.box((knob - 0.1, d + 0.075, 1.0), (knob + 0.02, d + 0.1, 1.03), metal, (0.35, 0.33, 0.3))
    s.box((knob - 0.01, d + 0.05, 1.0), (knob + 0.02, d + 0.075, 1.03), metal, (0.35, 0.33, 0.3))
    _casing(s, o, metal, tint)


def _casing(s: Surfaces, o: Opening, material: int, tint: np.ndarray) -> None:
    """The frame around a door or passage."""
    x0, x1, high = o.start, o.end, o.high
    s.box((x0 - 0.07, 0, 0), (x0, 0.02, high), material, tint, skip="y- z-")
    s.box((x1, 0, 0), (x1 + 0.07, 0.02, high), material, tint, skip="y- z-")
    s.box((x0 - 0.07, 0, high), (x1 + 0.07, 0.02, high + 0.07), material, tint, skip="y-")
