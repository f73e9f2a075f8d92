"""Storage: shelves, cabinets, wardrobes, the kitchen; built as in `furniture`."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tf_lab.data.rooms.decor import BLACK, Kit, Piece, books, handle, legs, things

Rng = np.random.Generator


def shelf(rng: Rng) -> Piece:
    """A bookcase with books, boxes and vases."""
    w, d, h = rng.uniform(0.6, 1.3), rng.uniform(0.26, 0.36), rng.uniform(1.1, 2.1)

    def build(kit: Kit) -> None:
        mat, t = kit.wood() if rng.random() < 0.7 else kit.painted, 0.022
        for x in (0.0, w - t):
            kit.s.box((x, 0, 0), (x + t, d, h), mat, skip="z-")
        kit.s.box((t, 0, 0.05), (w - t, 0.012, h), mat, kit.tint(0.85))
        levels = np.linspace(0.06, h - t, max(3, round(h / 0.36) + 1))
        for z in levels:
            kit.s.box((t, 0.012, z), (w - t, d - 0.006, z + t), mat, skip="x- x+ y-")
        for z, above in pairwise(levels):
            room = (t + 0.01, 0.03, w - t - 0.01, d - 0.03)
            if rng.random() < 0.72:
                books(kit, room, z + t, above - z - t)
            else:
                things(kit, room, z + t, 3, above - z - t - 0.03)
        if h < 1.5:
            things(kit, (0.05, 0.03, w - 0.05, d - 0.03), h, 2)

    return Piece("shelf", w, d, h, build)


def cabinet(rng: Rng, w: float, d: float, h: float, name: str, drawers: bool) -> Piece:
    """A closed body with doors or drawers, on feet or a plinth; things on top if it is low."""

    def build(kit: Kit) -> None:
        mat = kit.wood() if rng.random() < 0.6 else kit.painted
        tint = kit.tint() if mat == kit.painted else np.ones(3)
        foot = rng.choice([0.0, 0.12])
        kit.s.box((0, 0, foot), (w, d - 0.02, h), mat, tint)
        if foot:
            legs(kit, w, d, foot, kit.painted, 0.03, True)
        columns = max(1, round(w / 0.48))
        rows = max(2, round((h - foot) / 0.24)) if drawers else 1
        xs = np.linspace(0.01, w - 0.01, columns + 1)
        zs = np.linspace(foot + 0.02, h - 0.02, rows + 1)
        front = 0.82 * tint if rng.random() < 0.5 else tint
        for k in range(columns):
            for z0, z1 in pairwise(zs):
                low = (xs[k] + 0.006, d - 0.02, z0 + 0.006)
                kit.s.box(low, (xs[k + 1] - 0.006, d, z1 - 0.006), mat, front, skip="y-")
                outer = xs[k] + 0.07 if k % 2 else xs[k + 1] - 0.07  # doors open in pairs
                middle = (xs[k] + xs[k + 1]) / 2 if drawers else outer
                handle(kit, float(np.clip(middle, 0.05, w - 0.05)), d, (z0 + z1) / 2, 0.1)
        if h < 1.3:
            things(kit, (0.06, 0.05, w - 0.06, d - 0.06), h, int(rng.integers(2, 6)))

    return Piece(name, w, d + 0.025, h, build)


def sideboard(rng: Rng) -> Piece:
    """A low, wide cabinet."""
    size = rng.uniform(0.9, 1.8), rng.uniform(0.38, 0.5), rng.uniform(0.5, 0.95)
    return cabinet(rng, *size, "sideboard", bool(rng.random() < 0.5))


def wardrobe(rng: Rng) -> Piece:
    """A tall cabinet."""
    size = rng.uniform(0.9, 1.7), rng.uniform(0.5, 0.62), rng.uniform(1.85, 2.15)
    return cabinet(rng, *size, "wardrobe", False)


def nightstand(rng: Rng) -> Piece:
    """A small chest of drawers."""
    size = rng.uniform(0.38, 0.5), rng.uniform(0.35, 0.42), rng.uniform(0.45, 0.6)
    return cabinet(rng, *size, "nightstand", True)


def counter(rng: Rng) -> Piece:
    """A kitchen counter with hanging cupboards above."""
    w, d = rng.uniform(1.4, 2.4), 0.62
    high = rng.uniform(2.0, 2.15)

    def build(kit: Kit) -> None:
        below = cabinet(rng, w, d - 0.03, 0.86, "counter", bool(rng.random() < 0.3))
        below.build(kit)
        kit.s.box(
            (0, 0, 0.862), (w, d + 0.01, 0.9), kit.glaze if rng.random() < 0.5 else kit.wood()
        )
        things(kit, (0.05, 0.08, w - 0.05, d - 0.08), 0.9, 5)
        n = int(rng.integers(1, 1 + int(w / 0.45)))
        tint = kit.tint()
        for k in range(n):
            kit.s.box((k * 0.45, 0, 1.45), (k * 0.45 + 0.445, 0.31, high), kit.painted, tint)
            kit.s.box(
                (k * 0.45 + 0.01, 0.31, 1.46),
                (k * 0.45 + 0.435, 0.328, high - 0.01),
                kit.painted,
                0.85 * tint,
                skip="y-",
            )
            handle(kit, k * 0.45 + 0.38, 0.328, 1.53, 0.08)

    return Piece("counter", w, d + 0.03, high, build)


def fridge(rng: Rng) -> Piece:
    """A fridge with notes on its door."""
    w, d, h = rng.uniform(0.55, 0.7), 0.62, rng.uniform(1.45, 1.9)

    def build(kit: Kit) -> None:
        tint = kit.tint(1.0) if rng.random() < 0.4 else np.ones(3) * rng.uniform(0.5, 1)
        kit.s.box((0, 0, 0.03), (w, d - 0.06, h), kit.painted, tint)
        cut = h * rng.uniform(0.3, 0.7)
        for z0, z1 in ((0.04, cut - 0.01), (cut, h)):
            kit.s.box((0, d - 0.055, z0), (w, d, z1), kit.painted, tint)
            handle(kit, 0.1, d, (z0 + z1) / 2, 0.06)
        for k in range(int(rng.integers(1, 4))):
            x, z = rng.uniform(0.2, w - 0.18), cut + 0.05 + 0.17 * k
            if z + 0.15 < h:
                kit.s.box((x, d, z), (x + 0.13, d + 0.006, z + 0.15), kit.poster(), skip="y-")

    return Piece("fridge", w, d + 0.03, h, build)


def television(rng: Rng) -> Piece:
    """A low stand with a television."""
    w, h = rng.uniform(1.1, 1.7), rng.uniform(0.4, 0.55)
    stand = cabinet(rng, w, 0.38, h, "stand", bool(rng.random() < 0.5))

    def build(kit: Kit) -> None:
        stand.build(Kit(kit.s, kit.palette, kit.rng, bare=True))
        x, z, wide = w / 2, h + 0.05, rng.uniform(0.8, w - 0.1)
        kit.s.box((x - 0.2, 0.12, h), (x + 0.2, 0.3, h + 0.012), kit.painted, BLACK)
        kit.s.box((x - 0.03, 0.18, h), (x + 0.03, 0.2, z + 0.02), kit.painted, BLACK)
        top = z + wide * 0.57
        kit.s.box((x - wide / 2, 0.2, z), (x + wide / 2, 0.24, top), kit.painted, BLACK)
        low, high = (
            (x - wide / 2 + 0.015, 0.241, z + 0.015),
            (x + wide / 2 - 0.015, 0.246, top - 0.015),
        )
        kit.picture(low, high, kit.poster() if rng.random() < 0.6 else kit.glaze, kit.tint(0.5))

    return Piece("television", w, 0.41, h + 0.05 + 0.57 * w, build)
