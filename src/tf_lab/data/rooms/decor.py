"""The small things: books, vases, boxes, cushions, handles, pictures; and what they are made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tf_lab.data.rooms.materials import Palette
from tf_lab.data.rooms.shapes import Surfaces, Tint, Vector
from tf_lab.data.rooms.textures import colour

Rng = np.random.Generator
Rect = Sequence[float]
METAL = (0.32, 0.3, 0.28)
BLACK = (0.13, 0.13, 0.14)


@dataclass(frozen=True)
class Kit:
    """What every builder needs: surfaces to add to, materials, the random source."""

    s: Surfaces
    palette: Palette
    rng: Rng
    bare: bool = False
    """Whether tops stay empty."""

    def wood(self) -> int:
        """One of the room's woods."""
        return self.palette.pick("wood", self.rng)

    def fabric(self) -> int:
        """One of the room's fabrics."""
        return self.palette.pick("fabric", self.rng)

    def poster(self) -> int:
        """Print or another picture."""
        return self.palette.pick("poster", self.rng)

    @property
    def painted(self) -> int:
        """Lacquer, to be tinted."""
        return self.palette.index["painted"][0]

    @property
    def glaze(self) -> int:
        """Stone or glaze."""
        return self.palette.index["glaze"][0]

    @property
    def rugged(self) -> int:
        """A rough, speckled surface, to be tinted."""
        return self.palette.index["rugged"][0]

    def tint(self, brightness: float = 0.9) -> np.ndarray:
        """A random colour [3] of about that brightness."""
        return np.clip(1.3 * brightness * colour(self.rng, 0.85, 0.3, 0.85), 0.05, 1.1)

    def picture(self, low: Vector, high: Vector, material: int, tint: Tint = (1, 1, 1)) -> None:
        """A thin panel that faces +y, its back open."""
        self.s.box(low, high, material, tint, skip="y-")


@dataclass(frozen=True)
class Piece:
    """A piece that can be built; sizes in metres."""

    name: str
    width: float
    depth: float
    height: float
    build: Callable[[Kit], None]


def legs(kit: Kit, w: float, d: float, h: float, mat: int, inset: float, round_: bool) -> None:
    """Four legs, square or round, for a top of w by d at height h (m)."""
    r = kit.rng.uniform(0.018, 0.03)
    for x in (inset + r, w - inset - r):
        for y in (inset + r, d - inset - r):
            if round_:
                with kit.s.at((x, y, 0)):
                    kit.s.lathe([(r * 0.7, 0), (r, h)], mat, sides=8)
            else:
                kit.s.box((x - r, y - r, 0), (x + r, y + r, h), mat, skip="z- z+")


def handle(kit: Kit, x: float, y: float, z: float, length: float) -> None:
    """A bar on a front at ``y``, centred at (x, z)."""
    kit.s.box(
        (x - length / 2, y + 0.01, z - 0.01),
        (x + length / 2, y + 0.024, z + 0.01),
        kit.painted,
        METAL,
    )


def cushion(kit: Kit, low: Vector, high: Vector, material: int) -> None:
    """A box with bevelled edges."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    bevel = 0.28 * float((high - low).min())
    a, b = low[2] + bevel, high[2] - bevel
    rings = [(low[2], bevel), (a, 0.0), (b, 0.0), (high[2], bevel)]
    loops = []
    for z, inset in rings:
        x0, y0, x1, y1 = low[0] + inset, low[1] + inset, high[0] - inset, high[1] - inset
        loops.append(np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]))
    for lower, upper in pairwise(loops):
        for k in range(4):
            j = (k + 1) % 4
            kit.s.polygon(np.array([lower[k], lower[j], upper[j], upper[k]]), material)
    kit.s.polygon(loops[-1], material)
    kit.s.polygon(loops[0][::-1], material)


def books(kit: Kit, area: Rect, z: float, room: float) -> None:
    """A row of standing books of a shelf's length, with gaps and a lying pile now and then."""
    rng, (x, y0, end, y1) = kit.rng, area
    while x < end - 0.03:
        if rng.random() < 0.07:
            x += rng.uniform(0.05, 0.2)
        if rng.random() < 0.1 and x + 0.26 < end:
            _pile(kit, x, y0, min(0.19, y1 - y0), z, min(room - 0.04, rng.uniform(0.08, 0.2)))
            x += 0.26
            continue
        thick = rng.uniform(0.018, 0.06)
        high = room * rng.uniform(0.6, 0.93)
        deep = min(y1 - y0, rng.uniform(0.14, 0.24))
        if x + thick > end:
            break
        kit.s.box((x, y0, z), (x + thick, y0 + deep, z + high), _cover(kit), kit.tint(), skip="z-")
        x += thick + rng.uniform(0.001, 0.005)


def _cover(kit: Kit) -> int:
    return kit.poster() if kit.rng.random() < 0.4 else kit.painted


def _pile(kit: Kit, x: float, y: float, deep: float, z: float, high: float) -> None:
    top = z + high
    while z < top - 0.02:
        thick = kit.rng.uniform(0.02, 0.045)
        wide = kit.rng.uniform(0.18, 0.25)
        kit.s.box((x, y, z), (x + wide, y + deep, z + thick), _cover(kit), kit.tint(), skip="z-")
        z += thick


def things(kit: Kit, area: Rect, z: float, count: int, room: float = 0.5) -> None:
    """Up to ``count`` things side by side on a surface, below ``room`` metres of height."""
    rng, (x0, y0, x1, y1) = kit.rng, area
    if kit.bare or x1 - x0 < 0.08 or count == 0:
        return
    slots = max(1, min(count, int((x1 - x0) / 0.24)))
    edges = np.linspace(x0, x1, slots + 1)
    for left, right in pairwise(edges):
        r = 0.5 * min(right - left, y1 - y0, 0.36)
        at = (rng.uniform(left + r, right - r + 1e-9), rng.uniform(y0 + r, y1 - r + 1e-9), z)
        makers = (_vase, _vase, _carton, _reading, _bowl, _bottles, _lamp)
        maker = makers[int(rng.integers(len(makers) - (room < 0.45)))]
        with kit.s.at(at, rng.uniform(0, 6.3)):
            maker(kit, r, room)


def _vase(kit: Kit, r: float, room: float) -> None:
    rng = kit.rng
    h, base = min(room, rng.uniform(0.14, 0.36)), min(r, rng.uniform(0.05, 0.11))
    belly, neck = base * rng.uniform(0.9, 1.0), base * rng.uniform(0.3, 0.8)
    shape = [(base * 0.6, 0), (belly, h * 0.4), (neck, h * 0.8), (neck * 1.25, h), (0, h - 0.01)]
    kit.s.lathe(shape, kit.glaze if rng.random() < 0.6 else kit.painted, kit.tint(1.0))


def _carton(kit: Kit, r: float, room: float) -> None:
    w, d = kit.rng.uniform(0.4, 0.7, 2) * r
    h = min(room, kit.rng.uniform(0.06, 0.26))
    material = (kit.poster(), kit.wood(), kit.rugged, kit.fabric())[int(kit.rng.integers(4))]
    kit.s.box((-w, -d, 0), (w, d, h), material, kit.tint(1.0), skip="z-")


def _reading(kit: Kit, r: float, room: float) -> None:
    z = 0.0
    for _ in range(int(kit.rng.integers(1, 5))):
        thick, w = kit.rng.uniform(0.012, 0.04), kit.rng.uniform(0.5, 0.68) * r
        if z + thick > room:
            break
        with kit.s.at((0, 0, z), kit.rng.uniform(-0.3, 0.3)):
            kit.s.box((-w, -0.7 * w, 0), (w, 0.7 * w, thick), _cover(kit), kit.tint(), skip="z-")
        z += thick


def _bowl(kit: Kit, r: float, room: float) -> None:
    a, h = min(r, 0.14), min(room, 0.09)
    shape = [(a * 0.4, 0), (a * 0.8, h * 0.4), (a, h), (a * 0.9, h), (0, h * 0.4)]
    kit.s.lathe(shape, kit.glaze, kit.tint(1.1))
    for turn in (0.3, 2.4, 4.5):  # fruit
        b = 0.3 * a
        with kit.s.at((0.4 * a * np.cos(turn), 0.4 * a * np.sin(turn), h * 0.55)):
            fruit = [(0.5 * b, 0), (b, 0.5 * b), (0.8 * b, 1.4 * b), (0, 1.8 * b)]
            kit.s.lathe(fruit, kit.rugged, kit.tint(1.1), sides=8)


def _bottles(kit: Kit, r: float, room: float) -> None:
    for turn in np.arange(int(kit.rng.integers(1, 4))) * 2.1:
        h, b = min(room, kit.rng.uniform(0.12, 0.3)), min(0.04, 0.4 * r)
        with kit.s.at((0.5 * r * np.cos(turn), 0.5 * r * np.sin(turn), 0)):
            shape = [(b, 0), (b, 0.65 * h), (0.4 * b, 0.78 * h), (0.4 * b, h), (0, h)]
            kit.s.lathe(
                shape, kit.poster() if kit.rng.random() < 0.5 else kit.painted, kit.tint(), sides=8
            )


def _lamp(kit: Kit, r: float, room: float) -> None:
    a, h = min(r, 0.14), min(room, kit.rng.uniform(0.35, 0.46))
    foot = [(0.55 * a, 0), (0.5 * a, 0.3 * h), (0.1 * a, 0.45 * h), (0.1 * a, 0.65 * h)]
    kit.s.lathe(foot, kit.glaze, kit.tint(1.0))
    kit.s.lathe([(a, 0.55 * h), (0.65 * a, h)], kit.fabric(), glow=0.8, double=True)
