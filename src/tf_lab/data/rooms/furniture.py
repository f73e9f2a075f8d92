"""Pieces of furniture, built from boxes and lathed solids.

A piece fills x in [0, width], y in [0, depth], z in [0, height] of its own frame; its back is at
y = 0, its front faces +y.
"""

from __future__ import annotations

import numpy as np

from tf_lab.data.rooms.decor import BLACK, Kit, Piece, cushion, handle, legs, things

Rng = np.random.Generator


def table(rng: Rng, w: float, d: float, h: float, name: str = "table", load: int = 3) -> Piece:
    """A table: top, apron, legs, and about ``load`` things on it."""

    def build(kit: Kit) -> None:
        mat = kit.wood()
        t = rng.uniform(0.025, 0.045)
        kit.s.box((0, 0, h - t), (w, d, h), mat)
        kit.s.box((0.06, 0.06, h - t - 0.07), (w - 0.06, d - 0.06, h - t), mat, skip="z+")
        legs(kit, w, d, h - t, mat, 0.02, bool(rng.random() < 0.4))
        things(kit, (0.06, 0.06, w - 0.06, d - 0.06), h, load)

    return Piece(name, w, d, h, build)


def dining_table(rng: Rng) -> Piece:
    """A table to sit at."""
    size = rng.uniform(1.0, 1.7), rng.uniform(0.7, 0.9), rng.uniform(0.72, 0.76)
    return table(rng, *size, load=int(rng.integers(2, 6)))


def coffee_table(rng: Rng) -> Piece:
    """A low table."""
    size = rng.uniform(0.7, 1.2), rng.uniform(0.45, 0.65), rng.uniform(0.36, 0.48)
    return table(rng, *size, name="coffee table", load=int(rng.integers(1, 4)))


def desk(rng: Rng) -> Piece:
    """A desk with a drawer block and a screen."""
    w, d, h = rng.uniform(1.1, 1.6), rng.uniform(0.6, 0.75), rng.uniform(0.72, 0.76)

    def build(kit: Kit) -> None:
        mat, body = kit.wood(), kit.wood()
        kit.s.box((0, 0, h - 0.03), (w, d, h), mat)
        legs(kit, w, d, h - 0.03, kit.painted, 0.02, False)
        x = w - 0.5
        kit.s.box((x, 0.08, 0.1), (x + 0.4, d - 0.08, h - 0.03), body, skip="z+")
        for k in range(3):
            z = 0.13 + k * 0.19
            kit.s.box(
                (x + 0.015, d - 0.08, z), (x + 0.385, d - 0.062, z + 0.17), body, kit.tint(0.8)
            )
            handle(kit, x + 0.2, d - 0.062, z + 0.11, 0.12)
        a = rng.uniform(0.3, w - 0.75)
        if rng.random() < 0.75:  # a screen and a keyboard
            kit.s.box((a + 0.18, 0.12, h), (a + 0.36, 0.27, h + 0.012), kit.painted, BLACK)
            kit.s.box((a + 0.25, 0.16, h), (a + 0.29, 0.18, h + 0.2), kit.painted, BLACK)
            kit.s.box((a, 0.18, h + 0.1), (a + 0.54, 0.215, h + 0.43), kit.painted, BLACK)
            kit.picture((a + 0.015, 0.216, h + 0.115), (a + 0.525, 0.22, h + 0.415), kit.poster())
            kit.s.box((a, 0.36, h), (a + 0.42, 0.5, h + 0.02), kit.poster(), kit.tint(0.4))
            things(kit, (a + 0.6, 0.1, w - 0.05, d - 0.1), h, 2)
            things(kit, (0.03, 0.1, a - 0.05, d - 0.1), h, 1)
        else:
            things(kit, (0.05, 0.06, w - 0.05, d - 0.1), h, 4)

    return Piece("desk", w, d, h, build)


def chair(rng: Rng) -> Piece:
    """A chair with a slatted or closed back."""
    w, d, h = rng.uniform(0.42, 0.5), rng.uniform(0.44, 0.52), rng.uniform(0.82, 0.98)
    seat = rng.uniform(0.44, 0.48)

    def build(kit: Kit) -> None:
        mat = kit.wood() if rng.random() < 0.7 else kit.painted
        tint = kit.tint() if mat == kit.painted else np.ones(3)
        cover = kit.fabric() if rng.random() < 0.6 else mat
        r = 0.04
        for x in (0.0, w - r):
            kit.s.box((x, d - r, 0), (x + r, d, seat - 0.04), mat, tint, skip="z- z+")
            kit.s.box((x, 0, 0), (x + r, r, h), mat, tint, skip="z-")
        kit.s.box((0.004, r + 0.002, seat - 0.04), (w - 0.004, d, seat), cover)
        if rng.random() < 0.5:
            for z in np.linspace(seat + 0.12, h - 0.09, int(rng.integers(2, 4))):
                kit.s.box((r, 0.008, z), (w - r, 0.03, z + 0.07), mat, tint, skip="x- x+")
        else:
            kit.s.box((r, 0.006, seat + 0.1), (w - r, 0.034, h - 0.02), cover, skip="x- x+")

    return Piece("chair", w, d, h, build)


def sofa(rng: Rng) -> Piece:
    """A sofa of two or three seats with cushions."""
    count = int(rng.integers(2, 4))
    seat, arm = rng.uniform(0.55, 0.68), rng.uniform(0.12, 0.2)
    w, d, h = count * seat + 2 * arm, rng.uniform(0.8, 0.95), rng.uniform(0.72, 0.9)

    def build(kit: Kit) -> None:
        mat, other = kit.fabric(), kit.fabric()
        kit.s.box((0, 0, 0.06), (w, d, 0.24), mat)
        kit.s.box((0, 0, 0.24), (w, 0.2, h), mat, skip="z-")
        top = rng.uniform(0.52, 0.64)
        for x in (0.0, w - arm):
            kit.s.box((x, 0.2, 0.24), (x + arm, d, top), mat, kit.tint(0.9), skip="z- y-")
        for k in range(count):
            x = arm + k * seat
            cushion(kit, (x + 0.01, 0.21, 0.24), (x + seat - 0.01, d - 0.01, 0.44), mat)
            cushion(kit, (x + 0.02, 0.2, 0.445), (x + seat - 0.02, 0.36, h + 0.04), mat)
            if rng.random() < 0.6:
                with kit.s.at((x + rng.uniform(0.05, 0.15), 0.44, 0.445), rng.uniform(-0.2, 0.2)):
                    cushion(kit, (0, -0.05, 0), (0.4, 0.07, 0.36), other)

    return Piece("sofa", w, d, h + 0.04, build)


def bed(rng: Rng) -> Piece:
    """A bed with its head at the wall: frame, mattress, blanket, pillows."""
    w, d, h = rng.choice([0.95, 1.4, 1.65]), rng.uniform(1.95, 2.1), rng.uniform(0.45, 0.56)
    head = rng.uniform(0.75, 1.1)

    def build(kit: Kit) -> None:
        mat, sheet, cover = kit.wood(), kit.painted, kit.fabric()
        kit.s.box((0, 0, 0), (w, 0.06, head), mat, skip="z-")
        kit.s.box((0, 0.06, 0.1), (w, d, 0.3), mat, skip="y-")
        for x in (0.02, w - 0.1):
            kit.s.box((x, d - 0.1, 0), (x + 0.08, d - 0.02, 0.1), mat, skip="z- z+")
        cushion(kit, (0.03, 0.07, 0.3), (w - 0.03, d - 0.03, h - 0.03), sheet)
        start = rng.uniform(0.55, 0.9)
        kit.s.box((0.0, start, 0.33), (w, d - 0.005, h), cover, skip="z-")
        kit.s.box(
            (0.004, start - 0.03, h - 0.01),
            (w - 0.004, start + 0.2, h + 0.025),
            cover,
            kit.tint(0.75),
        )
        count = 1 if w < 1.2 else 2
        for k in range(count):
            x = w / count * (k + 0.5) - 0.3
            cushion(kit, (x, 0.1, h - 0.03), (x + 0.6, 0.46, h + 0.1), kit.fabric())
        if rng.random() < 0.5:
            with kit.s.at((w * 0.3, d * 0.65, h), rng.uniform(-0.6, 0.6)):
                cushion(kit, (0, 0, 0), (0.42, 0.4, 0.14), kit.fabric())

    return Piece("bed", w, d, h + 0.03, build)


def floor_lamp(rng: Rng) -> Piece:
    """A standing lamp."""
    r, h = rng.uniform(0.16, 0.22), rng.uniform(1.4, 1.75)

    def build(kit: Kit) -> None:
        with kit.s.at((r, r, 0)):
            kit.s.lathe([(r * 0.8, 0), (r * 0.8, 0.025), (0, 0.03)], kit.painted, (0.3, 0.3, 0.3))
            kit.s.lathe([(0.014, 0.02), (0.014, h - 0.28)], kit.painted, (0.3, 0.3, 0.3), sides=8)
            shade = [(r, h - 0.3), (r * rng.uniform(0.5, 0.9), h)]
            kit.s.lathe(shade, kit.fabric(), glow=0.7, sides=14, double=True)

    return Piece("floor lamp", 2 * r, 2 * r, h, build)


def plant(rng: Rng) -> Piece:
    """A pot with a bush."""
    r, h = rng.uniform(0.17, 0.26), rng.uniform(0.7, 1.5)

    def build(kit: Kit) -> None:
        pot = rng.uniform(0.22, 0.38)
        green = np.array([0.35, 0.65, 0.25]) * rng.uniform(0.6, 1.2)
        with kit.s.at((r, r, 0)):
            shape = [(r * 0.55, 0), (r * 0.8, pot), (r * 0.7, pot), (0, pot - 0.03)]
            kit.s.lathe(shape, kit.glaze)
            kit.s.lathe([(0.02, pot - 0.03), (0.015, h - 0.3)], kit.wood(), sides=6)
            for _ in range(int(rng.integers(4, 9))):
                z, turn = rng.uniform(pot + 0.05, h - 0.22), rng.uniform(0, 6.3)
                b = rng.uniform(0.35, 0.6) * r
                with kit.s.at(((r - b) * np.cos(turn), (r - b) * np.sin(turn), z)):
                    bush = [(0.01, 0), (b, 0.07), (b * 0.8, 0.15), (0, 0.22)]
                    kit.s.lathe(bush, kit.rugged, green * rng.uniform(0.7, 1.3), sides=7)

    return Piece("plant", 2 * r, 2 * r, h, build)


def crates(rng: Rng) -> Piece:
    """A stack of cardboard boxes."""
    w, d = rng.uniform(0.4, 0.65), rng.uniform(0.4, 0.55)
    heights = rng.uniform(0.2, 0.38, int(rng.integers(1, 4)))

    def build(kit: Kit) -> None:
        z = 0.0
        for k, high in enumerate(heights):
            size = np.array([w, d]) * rng.uniform(0.6, 0.8)
            with kit.s.at((w / 2, d / 2, z), rng.uniform(-0.25, 0.25)):
                mat = (kit.wood(), kit.poster(), kit.rugged)[int(rng.integers(3))]
                kit.s.box((*(-size / 2), 0), (*(size / 2), high), mat, kit.tint(0.9), skip="z-")
            z += high + 0.001 * (k + 1)

    return Piece("crates", w, d, float(heights.sum()) + 0.01, build)


def pouf(rng: Rng) -> Piece:
    """A round stool."""
    r, h = rng.uniform(0.18, 0.3), rng.uniform(0.36, 0.5)

    def build(kit: Kit) -> None:
        with kit.s.at((r, r, 0)):
            shape = [(r * 0.85, 0), (r, 0.1), (r, h - 0.06), (r * 0.85, h), (0, h + 0.01)]
            kit.s.lathe(shape, kit.fabric(), sides=14)

    return Piece("pouf", 2 * r, 2 * r, h + 0.01, build)
