"""Procedural textures: seeded, tileable pictures of plaster, wood, brick, cloth, print and more.

Every maker returns linear-light RGB [S, S, 3] in 0..1 and the size of a texel in metres.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

SIZE = 512
GAMMA = 2.2
Rng = np.random.Generator
Texture = tuple[np.ndarray, float]


def noise(rng: Rng, slope: float = 1.0, stretch: float = 1.0, finest: float = 3.0) -> np.ndarray:
    """Tileable fractal noise [S, S] of zero mean and unit variance.

    Args:
        rng: the random source.
        slope: amplitude falls as frequency ** -slope (0: white, 1: multi-scale, 2: clouds).
        stretch: how many times longer features are along u than along v.
        finest: the shortest wavelength, texels.
    """
    fy = np.fft.fftfreq(SIZE)[:, None] * SIZE
    fx = np.fft.rfftfreq(SIZE)[None] * SIZE
    radius = np.hypot(fy / np.sqrt(stretch), fx * np.sqrt(stretch))
    amplitude = np.maximum(radius, 2.0) ** -slope * np.exp(-((radius * finest / SIZE) ** 2))
    amplitude[0, 0] = 0
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((SIZE, SIZE))) * amplitude, (SIZE, SIZE))
    return field / field.std()


def cells(rng: Rng, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Tileable Voronoi cells: the cell's number [S, S], and the gap to the next cell (texels)."""
    points = rng.uniform(0, SIZE, (count, 2))
    tree = cKDTree(points, boxsize=SIZE)
    pixels = np.moveaxis(np.mgrid[:SIZE, :SIZE], 0, -1).reshape(-1, 2) + 0.5
    distance, index = tree.query(pixels, k=2)
    gap = (distance[:, 1] - distance[:, 0]).reshape(SIZE, SIZE)
    return index[:, 0].reshape(SIZE, SIZE), gap


def colour(rng: Rng, saturation: float = 0.5, low: float = 0.25, high: float = 0.85) -> np.ndarray:
    """A random colour [3]: any hue, given the largest saturation and the range of brightness."""
    # homes are mostly warm: reds to yellows, some blues and greens, a few of any hue
    low_hue, high_hue = ((0.0, 0.16), (0.5, 0.66), (0.2, 0.4), (0.0, 1.0))[
        rng.choice(4, p=[0.5, 0.22, 0.15, 0.13])
    ]
    phase = 2 * np.pi * (rng.uniform(low_hue, high_hue) - np.array([0, 1 / 3, 2 / 3]))
    mix = rng.uniform(0.15, 1) * saturation
    return rng.uniform(low, high) * (1 - mix * (0.5 - 0.5 * np.cos(phase)))


def shade(base: np.ndarray, field: np.ndarray) -> np.ndarray:
    """A colour [3] or image times a brightness field [S, S]."""
    return np.clip(base * np.clip(field, 0.04, 3.0)[..., None], 0, 1)


def linear(colour: np.ndarray) -> np.ndarray:
    """Linear light [..., 3] of colours of 8 bits, never quite black or white."""
    return np.clip((colour.astype(np.float32) / 255) ** GAMMA, 0.03, 0.95)


def plaster(rng: Rng, strength: float = 0.06) -> Texture:
    """Painted plaster: clouds, trowel marks and specks; ``strength`` is their contrast."""
    base = 0.5 + 0.45 * colour(rng, 0.35, 0.5, 1.0)
    marks = noise(rng, 1.0, 2.0, 4)
    specks = np.clip(noise(rng, 0.3, 1.0, 3) - 1.8, 0, 1.5)
    field = 1 + strength * (0.6 * noise(rng, 1.6) + marks) - 2.5 * strength * specks
    return shade(base * 0.9, field), 0.009


def patchwork(rng: Rng) -> Texture:
    """Worn paint: blotches of two colours with ragged edges."""
    a, b = colour(rng, 0.5, 0.4, 0.9), colour(rng, 0.5, 0.3, 0.8)
    mix = 1 / (1 + np.exp(-4 * noise(rng, 1.3, 1.0, 4)))[..., None]
    return shade(a * mix + b * (1 - mix), 1 + 0.08 * noise(rng, 0.7)), 0.008


def wallpaper(rng: Rng) -> Texture:
    """Leaves or petals strewn over a plain ground."""
    image = np.tile(colour(rng, 0.4, 0.5, 0.95), (SIZE, SIZE, 1))
    inks = [colour(rng, 0.8, 0.15, 0.8) for _ in range(3)]
    for _ in range(170):
        (cy, cx), turn = rng.uniform(0, SIZE, 2), rng.uniform(0, np.pi)
        long, wide = rng.uniform(8, 22), rng.uniform(3, 9)
        r = int(long) + 2
        ys, xs = np.mgrid[int(cy) - r : int(cy) + r, int(cx) - r : int(cx) + r]
        a = (xs - cx) * np.cos(turn) + (ys - cy) * np.sin(turn)
        b = (ys - cy) * np.cos(turn) - (xs - cx) * np.sin(turn)
        inside = (a / long) ** 2 + (b / wide) ** 2 < 1
        image[ys[inside] % SIZE, xs[inside] % SIZE] = inks[rng.integers(3)]
    return shade(image, 1 + 0.07 * noise(rng, 1.0)), 0.007


def stripes(rng: Rng) -> Texture:
    """Striped wallpaper of uneven widths, a little worn."""
    edges = np.cumsum(rng.uniform(5, 22, 60)).astype(int)
    inks = np.stack([colour(rng, 0.5, 0.35, 0.95) for _ in range(3)])
    column = inks[rng.integers(0, 3, 61)][np.searchsorted(edges, np.arange(SIZE), "right")]
    return shade(np.tile(column[None], (SIZE, 1, 1)), 1 + 0.09 * noise(rng, 1.2)), 0.008


def brick(rng: Rng) -> Texture:
    """Bricks with mortar, every brick its own tone."""
    high, wide = 16, 32
    y, x = np.mgrid[:SIZE, :SIZE]
    row = y // high
    shifted = (x + (row % 2) * wide // 2) % SIZE
    tone = rng.uniform(0.55, 1.25, (SIZE // high, SIZE // wide))[row, shifted // wide]
    mortar = ((y % high) < 2) | ((shifted % wide) < 2)
    base = np.array([0.62, 0.3, 0.22]) if rng.random() < 0.6 else colour(rng, 0.3, 0.5, 0.9)
    image = np.where(mortar[..., None], 0.6, base * tone[..., None])
    return shade(image, 1 + 0.16 * noise(rng, 0.8)), rng.uniform(0.005, 0.0075)


def tiles(rng: Rng) -> Texture:
    """Square tiles with grout, marbled, every tile its own tone."""
    side = int(rng.choice([32, 64]))
    y, x = np.mgrid[:SIZE, :SIZE]
    n = SIZE // side
    a, b = colour(rng, 0.4, 0.35, 0.95), colour(rng, 0.4, 0.25, 0.9)
    choice = rng.random((n, n)) < rng.choice([0.0, 0.3, 0.5])
    image = np.where(choice[y // side, x // side][..., None], a, b)
    tone = rng.uniform(0.75, 1.2, (n, n))[y // side, x // side]
    veins = 1 - 0.35 * np.exp(-((noise(rng, 1.5) / 0.12) ** 2))
    grout = ((y % side) < 2) | ((x % side) < 2)
    image = np.where(grout[..., None], 0.35, shade(image, tone * veins))
    return shade(image, 1 + 0.08 * noise(rng, 0.7)), rng.uniform(0.005, 0.0075)


def planks(rng: Rng) -> Texture:
    """Wooden boards along u with uneven lengths, tones and grain."""
    count = int(rng.choice([16, 24, 32]))
    row = np.arange(SIZE) * count // SIZE
    grain = noise(rng, 1.1, 14.0, 2.5)
    tone, seam = np.ones((SIZE, SIZE)), np.zeros((SIZE, SIZE), bool)
    for r in range(count):
        ends = np.sort(rng.choice(SIZE, 5, replace=False))
        tones = rng.uniform(0.65, 1.25, 5)
        tone[row == r] = tones[np.searchsorted(ends, np.arange(SIZE)) % 5]
        grain[row == r] = np.roll(grain[row == r], rng.integers(SIZE), axis=1)
        seam[np.ix_(row == r, ends)] = True
    seam |= (np.diff(row, prepend=-1) != 0)[:, None]
    field = tone * (1 + 0.16 * grain) * np.where(seam, 0.45, 1)
    return shade(_wood_colour(rng), field), rng.uniform(0.005, 0.008)


def wood(rng: Rng) -> Texture:
    """A wooden surface without boards: grain and some knots."""
    grain = noise(rng, 1.2, 10.0, 2.5)
    rings = np.sin(6 * noise(rng, 2.0, 6.0))
    return shade(_wood_colour(rng), 1 + 0.2 * grain + 0.13 * rings), 0.004


def _wood_colour(rng: Rng) -> np.ndarray:
    tones = np.array([[0.62, 0.42, 0.24], [0.35, 0.2, 0.11], [0.78, 0.62, 0.42], [0.5, 0.27, 0.14]])
    return tones[rng.integers(4)] * rng.uniform(0.8, 1.15) * rng.uniform(0.93, 1.07, 3)


def carpet(rng: Rng) -> Texture:
    """Speckled pile over soft blotches."""
    base = colour(rng, 0.6, 0.25, 0.75)
    return shade(base, 1 + 0.16 * noise(rng, 1.2) + 0.17 * noise(rng, 0.2, 1.0, 4)), 0.006


def rug(rng: Rng) -> Texture:
    """A woven rug: patches of a few colours, outlined."""
    index, gap = cells(rng, int(rng.integers(60, 260)))
    inks = np.stack([colour(rng, 0.9, 0.12, 0.85) for _ in range(5)])
    image = inks[rng.integers(0, 5, index.max() + 1)][index]
    image = np.where((gap < 3)[..., None], inks[0] * 0.4, image)
    return shade(image, 1 + 0.13 * noise(rng, 0.6)), 0.004


def terrazzo(rng: Rng) -> Texture:
    """Stone chips in cement."""
    index, gap = cells(rng, 1400)
    inks = np.stack([colour(rng, 0.5, 0.2, 0.95) for _ in range(6)])
    chip = rng.random(index.max() + 1) < 0.6
    image = inks[rng.integers(0, 6, index.max() + 1)][index]
    cement = 0.4 + 0.4 * colour(rng, 0.3)
    image = np.where((chip[index] & (gap > 4))[..., None], image, cement)
    return shade(image, 1 + 0.06 * noise(rng)), 0.006


def fabric(rng: Rng) -> Texture:
    """Upholstery: a weave with blotches, sometimes a print."""
    base = colour(rng, 0.8, 0.2, 0.8)
    field = 1 + 0.12 * noise(rng, 1.1) + 0.12 * noise(rng, 0.2, 1.0, 4)
    image = np.tile(base, (SIZE, SIZE, 1))
    if rng.random() < 0.5:
        level = rng.uniform(-0.2, 0.8)
        image = np.where((noise(rng, 1.4, 1.0, 6) > level)[..., None], colour(rng, 0.8), image)
    return shade(image, field), 0.004


def marble(rng: Rng) -> Texture:
    """Strong multi-scale noise in two colours: stone, glaze, camouflage."""
    a, b = colour(rng, 0.7, 0.5, 0.95), colour(rng, 0.7, 0.1, 0.4)
    mix = (0.5 + 0.5 * np.sin(2.2 * noise(rng, 1.2, 1.0, 4)))[..., None]
    return shade(a * mix + b * (1 - mix), 1 + 0.08 * noise(rng, 0.6)), 0.004


def painted(rng: Rng) -> Texture:
    """White with faint scuffs, to be tinted: furniture lacquer, plastic, metal."""
    field = 0.85 + 0.05 * noise(rng, 1.0) + 0.04 * noise(rng, 0.4, 1.0, 4)
    return shade(np.ones(3), field), 0.004


def rugged(rng: Rng) -> Texture:
    """Light grey with strong multi-scale speckle, to be tinted: leaves, cardboard, peel."""
    field = 0.75 + 0.22 * noise(rng, 0.9) + 0.1 * noise(rng, 0.2, 1.0, 4)
    return shade(np.ones(3), field), 0.0035


def poster(rng: Rng) -> Texture:
    """Print: blocks of pictures, headings and lines of words."""
    image = np.tile(0.55 + 0.4 * colour(rng, 0.5, 0.5, 1.0), (SIZE, SIZE, 1))
    for _ in range(70):
        h, w = rng.integers(30, 110, 2)
        y, x = rng.integers(0, SIZE, 2)
        ys, xs = np.arange(y, y + h) % SIZE, np.arange(x, x + w) % SIZE
        ink = colour(rng, 0.9, 0.05, 0.9)
        image[np.ix_(ys, xs)] = ink
        if rng.random() < 0.6:
            line = int(rng.integers(6, 14))
            words = rng.random((h // line + 1, w // 5 + 1)) < 0.7
            mark = words[np.arange(h) // line][:, np.arange(w) // 5]
            mark &= (np.arange(h) % line < line * 0.6)[:, None]
            image[np.ix_(ys, xs)] = np.where(mark[..., None], ink, 1 - 0.8 * ink)
    return shade(image, 1 + 0.1 * noise(rng, 1.2)), 0.0035


def outside(rng: Rng) -> Texture:
    """What a window shows: sky with clouds, treetops below."""
    clouds = np.clip(0.5 + 0.25 * noise(rng, 1.6, 2.0, 6), 0, 1)[..., None]
    sky = np.array([0.55, 0.72, 0.95]) * (1 - clouds) + 0.97 * clouds
    trees = shade(np.array([0.25, 0.38, 0.16]), 1 + 0.5 * noise(rng, 1.0, 1.0, 5))
    return np.where((noise(rng, 1.7, 3.0, 8) > 0.5)[..., None], trees, sky), 0.008
