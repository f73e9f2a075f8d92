"""Where things go: furniture along the walls and in groups, pictures and lamps, room to walk."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tf_lab.data.rooms import furniture as f, storage as st
from tf_lab.data.rooms.decor import Kit, Piece
from tf_lab.data.rooms.footprint import FreeSpace, Placed, overlap
from tf_lab.data.rooms.layout import Plan, Wall
from tf_lab.data.rooms.models import Furniture

Rng = np.random.Generator
Maker = Callable[[Rng], Piece]
ENTRY = 0.45  # metres before a passage, where one must be able to stand

THEMES: dict[str, tuple[Maker, ...]] = {
    "living room": (f.sofa, st.television, st.shelf, st.sideboard, f.plant, f.sofa, f.floor_lamp),
    "bedroom": (f.bed, st.wardrobe, st.sideboard, f.desk, f.floor_lamp, f.pouf, st.shelf),
    "study": (f.desk, st.shelf, st.shelf, st.sideboard, f.plant, f.crates, st.wardrobe),
    "dining room": (f.dining_table, st.sideboard, st.shelf, f.plant, st.wardrobe, f.floor_lamp),
    "kitchen": (st.counter, st.fridge, f.dining_table, st.shelf, f.crates, st.sideboard),
}
FILLERS: tuple[Maker, ...] = (
    f.plant, f.crates, f.pouf, f.floor_lamp, f.chair, st.nightstand, st.shelf, st.sideboard,
)  # fmt: skip


class Arranger:
    """Places pieces so that nothing intersects, doors stay clear and a person can walk."""

    def __init__(self, kit: Kit, plan: Plan, furniture: Furniture | None = None) -> None:
        self._kit, self._plan, self._rng, self._furniture = kit, plan, kit.rng, furniture
        self.placed: list[Placed] = []
        self._taken: list[list[list[float]]] = [
            [[o.start - 0.1, o.end + 0.1, o.low - 0.1, o.high + 0.12] for o in w.openings]
            for w in plan.walls
        ]
        self._doorways = [
            _corners(wall.a, wall.yaw, o.start - 0.05, 0.0, o.end - o.start + 0.1, 0.8)
            for wall in plan.walls
            for o in wall.openings
            if o.kind in ("door", "passage")
        ]
        entries = [
            _point(wall.a, wall.yaw, (o.start + o.end) / 2, ENTRY)
            for wall in plan.walls
            for o in wall.openings
            if o.kind == "passage"
        ]
        self._entries = np.array(entries).reshape(-1, 2)
        self._has_rug = False
        floor = FreeSpace(plan, []).walkable(0.4).sum()
        self._least = max(0.28 * floor, 360)

    def made(self, maker: Maker) -> Piece:
        """A piece, or a model that stands in for it."""
        piece = maker(self._rng)
        return self._furniture.instead(piece) if self._furniture else piece

    def _put(self, piece: Piece, origin: np.ndarray, yaw: float, margin: float = 0.03) -> bool:
        """Build the piece with its back left corner at ``origin``, if it fits."""
        corners = _corners(origin, yaw, 0, 0, piece.width, piece.depth)
        if not self._inside(corners):
            return False
        if any(overlap(corners, p.corners, margin) for p in self.placed):
            return False
        if any(overlap(corners, door, 0.0) for door in self._doorways):
            return False
        placed = Placed(piece.name, corners, piece.height)
        space = FreeSpace(self._plan, [*self.placed, placed])
        walkable = space.walkable(0.4)
        if walkable.sum() < self._least or not space.holds(walkable, self._entries):
            return False
        with self._kit.s.at((*origin, 0), yaw):
            piece.build(self._kit)
        self.placed.append(placed)
        return True

    def _inside(self, corners: np.ndarray) -> bool:
        grid = np.linspace(0, 1, 9)
        across = corners[0] + grid[:, None] * (corners[1] - corners[0])
        points = across[:, None] + grid[:, None] * (corners[3] - corners[0])
        return bool(self._plan.inside(points).all())

    def at_wall(self, piece: Piece, beside: float = 0.03) -> tuple[Wall, float] | None:
        """Against a random wall (not before windows if too high); the wall and where along it.

        ``beside`` (m) is left free to the wall's ends.
        """
        for _ in range(30):
            number = int(self._rng.integers(len(self._plan.walls)))
            wall = self._plan.walls[number]
            room = wall.length - piece.width - 2 * beside
            if room <= 0:
                continue
            corner = self._rng.random() < 0.35  # furniture likes corners
            x = beside + room * float(self._rng.choice([0, 1]) if corner else self._rng.random())
            span = [x, x + piece.width, 0.0, piece.height]
            if _clash(span, self._taken[number]):
                continue
            origin = _point(wall.a, wall.yaw, x, self._rng.uniform(0.025, 0.06))
            if self._put(piece, origin, wall.yaw):
                span[3] += 0.35  # what stands on it may hide the wall
                self._taken[number].append(span)
                return wall, x
        return None

    def in_room(self, piece: Piece) -> tuple[np.ndarray, float] | None:
        """Anywhere on the floor, mostly aligned with the walls: origin and yaw."""
        rects = np.array(self._plan.rects)
        for _ in range(30):
            x0, y0, x1, y1 = rects[self._rng.integers(len(rects))]
            yaw = self._rng.choice([0, 0.5, 1, 1.5]) * np.pi + self._rng.normal(0, 0.06)
            origin = self._rng.uniform([x0, y0], [x1, y1])
            if self._put(piece, origin, yaw, 0.3):
                return origin, yaw
        return None

    def before(self, piece: Piece, origin: np.ndarray, yaw: float, x: float, y: float) -> bool:
        """Facing a piece that stands at ``origin``: centred at x, ``y`` in front of its back."""
        turn = yaw + np.pi + self._rng.normal(0, 0.12)
        centre = _point(origin, yaw, x, y + piece.depth / 2)
        start = centre - _point(np.zeros(2), turn, piece.width / 2, piece.depth / 2)
        return self._put(piece, start, turn, 0.01)

    def group(self, piece: Piece) -> None:
        """Place a piece with what belongs to it."""
        rng = self._rng
        if piece.name == "table" and rng.random() < 0.7:
            spot = self.in_room(piece)
        else:
            found = self.at_wall(piece)
            spot = found and (_point(found[0].a, found[0].yaw, found[1], 0.04), found[0].yaw)
        if spot is None:
            return
        origin, yaw = spot
        w, d = piece.width, piece.depth
        if piece.name in ("table", "desk"):
            self._seats(piece, origin, yaw)
        elif piece.name == "bed":
            for side in (-0.5, w + 0.03):
                if rng.random() < 0.8:
                    stand = self.made(st.nightstand)
                    x = -stand.width - 0.04 if side < 0 else side
                    self._put(stand, _point(origin, yaw, x, 0.0), yaw, 0.01)
        elif piece.name == "sofa":
            low = self.made(f.coffee_table if rng.random() < 0.8 else f.pouf)
            self.before(low, origin, yaw, w / 2, d + rng.uniform(0.3, 0.5))
            self.rug(_point(origin, yaw, w / 2, d + 0.45), yaw)

    def _seats(self, piece: Piece, origin: np.ndarray, yaw: float) -> None:
        """Chairs along the sides of a table or desk."""
        w, d, rng = piece.width, piece.depth, self._rng
        far = _point(origin, yaw, w, d)
        side = _point(origin, yaw, w, 0)
        other = _point(origin, yaw, 0, d)
        sides = [(origin, yaw, w, d), (far, yaw + np.pi, w, d)]
        sides += [(side, yaw + np.pi / 2, d, w), (other, yaw - np.pi / 2, d, w)]
        for start, turn, along, away in sides[: 1 if piece.name == "desk" else 4]:
            spots = [0.28, 0.72] if along > 1.15 and piece.name == "table" else [0.5]
            for spot in spots:
                if rng.random() < 0.85:
                    gap = away + rng.uniform(0.06, 0.22)
                    self.before(self.made(f.chair), start, turn, spot * along, gap)

    def rug(self, centre: np.ndarray, yaw: float) -> None:
        """A rug around ``centre`` (one a room: rugs would lie in each other)."""
        size = self._rng.uniform([1.2, 0.9], [2.0, 1.4])
        corners = _corners(centre, yaw, -size[0] / 2, -size[1] / 2, size[0], size[1])
        if self._has_rug or not self._inside(corners):
            return
        self._has_rug = True
        with self._kit.s.at((*centre, 0), yaw):
            low, high = (*(-size / 2), 0), (*(size / 2), 0.012)
            self._kit.s.box(low, high, self._kit.palette.index["rug"][0], skip="z-")

    def pictures(self, count: int) -> None:
        """Framed pictures on free parts of the walls, 2-3 cm proud of them, never overlapping."""
        rng, kit = self._rng, self._kit
        for _ in range(6 * count):
            number = int(rng.integers(len(self._plan.walls)))
            wall = self._plan.walls[number]
            w, h = rng.uniform(0.3, 1.1), rng.uniform(0.3, 0.85)
            low = rng.uniform(1.1, 1.7)
            if wall.length < w + 0.4 or low + h > self._plan.height - 0.1:
                continue
            x = rng.uniform(0.15, wall.length - w - 0.15)
            span = [x - 0.06, x + w + 0.06, low - 0.06, low + h + 0.06]
            if _clash(span, self._taken[number]):
                continue
            self._taken[number].append(span)
            count -= 1
            proud, rim = rng.uniform(0.02, 0.03), rng.choice([0.0, 0.03])
            material = kit.poster() if rng.random() < 0.75 else kit.palette.index["rug"][0]
            with kit.s.at((*wall.a, 0), wall.yaw):
                kit.picture((x, 0, low), (x + w, proud - 0.006, low + h), kit.wood())
                inner = (x + rim, proud - 0.006, low + rim), (x + w - rim, proud, low + h - rim)
                kit.picture(*inner, material, kit.tint(1.2) if rng.random() < 0.4 else np.ones(3))
            if count <= 0:
                return

    def radiators(self) -> None:
        """A ribbed radiator under a window where nothing stands."""
        kit = self._kit
        for number, wall in enumerate(self._plan.walls):
            for o in wall.openings:
                span = [o.start + 0.05, o.end - 0.05, 0.0, o.low - 0.12]
                clear = not _clash(span, self._taken[number])
                if o.kind != "window" or not clear or self._rng.random() < 0.4:
                    continue
                base = _corners(wall.a, wall.yaw, span[0], 0.0, span[1] - span[0], 0.13)
                if any(overlap(base, p.corners, 0.02) for p in self.placed):
                    continue
                self._taken[number].append(span)
                self.placed.append(Placed("radiator", base, span[3]))
                with kit.s.at((*wall.a, 0), wall.yaw):
                    kit.s.box((span[0], 0.05, 0.14), (span[1], 0.09, span[3] - 0.02), kit.painted)
                    for x in np.arange(span[0] + 0.02, span[1] - 0.06, 0.09):
                        kit.s.box(
                            (x, 0.09, 0.12), (x + 0.05, 0.12, span[3]), kit.painted, skip="y-"
                        )


def furnish(
    kit: Kit,
    plan: Plan,
    theme: Sequence[Maker] | None = None,
    dividers: Sequence[Piece] = (),
    furniture: Furniture | None = None,
) -> list[Placed]:
    """Furnish a room; returns what stands on the floor.

    Args:
        kit: what to build with.
        plan: the room.
        theme: what to place; None: one of `THEMES` at random.
        dividers: pieces that go first, and far into the room.
        furniture: models in place of some of the others.
    """
    rng = kit.rng
    arranger = Arranger(kit, plan, furniture)
    for piece in dividers:
        arranger.at_wall(piece, beside=0.6)
    for maker in theme or THEMES[str(rng.choice(list(THEMES)))]:
        arranger.group(arranger.made(maker))
    for _ in range(14):
        if len(arranger.placed) >= 9:
            break
        arranger.group(arranger.made(FILLERS[rng.integers(len(FILLERS))]))
    arranger.radiators()
    arranger.pictures(int(rng.integers(3, 9)))
    if rng.random() < 0.6:
        x0, y0, x1, y1 = plan.rects[0]
        arranger.rug(
            np.array([x0 + x1, y0 + y1]) / 2, rng.choice([0, np.pi / 2]) + rng.normal(0, 0.1)
        )
    return arranger.placed


def hang_lamp(kit: Kit, position: np.ndarray, height: float) -> None:
    """A lamp around a light below the ceiling (``height``, m)."""
    r = kit.rng.uniform(0.12, 0.24)
    with kit.s.at(position):
        shade = [(r, -0.1), (r * kit.rng.uniform(0.4, 1.0), 0.09)]
        kit.s.lathe(shade, kit.fabric(), glow=0.8, sides=14, double=True)
        kit.s.lathe([(0.01, 0.0), (0.01, height - position[2])], kit.painted, sides=6)


def _point(origin: np.ndarray, yaw: float, x: float, y: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return origin + np.array([c * x - s * y, s * x + c * y])


def _corners(origin: np.ndarray, yaw: float, x: float, y: float, w: float, d: float) -> np.ndarray:
    """Counter-clockwise corners [4, 2] of a rectangle in a turned frame."""
    spots = [(x, y), (x + w, y), (x + w, y + d), (x, y + d)]
    return np.stack([_point(origin, yaw, *spot) for spot in spots])


def _clash(span: list[float], taken: list[list[float]]) -> bool:
    """Whether [x0, x1, z0, z1] on a wall meets any that are taken."""
    return any(
        span[0] < t[1] and t[0] < span[1] and span[2] < t[3] and t[2] < span[3] for t in taken
    )
