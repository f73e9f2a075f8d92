"""The materials of a room: textures with mip levels, looked up in metres.

Mip levels stand in for supersampling inside a face: a lookup averages about the area that a pixel
covers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tf_lab.data.rooms import textures as tx
from tf_lab.data.rooms.textures import SIZE, Rng, Texture

Maker = Callable[[Rng], Texture]
Role = tuple[str, Maker]

WALLS = (
    tx.plaster,
    tx.plaster,
    tx.plaster,
    tx.patchwork,
    tx.wallpaper,
    tx.stripes,
    tx.brick,
    tx.planks,
    tx.marble,
)
FLOORS = (tx.planks, tx.planks, tx.tiles, tx.carpet, tx.terrazzo, tx.tiles)


@dataclass(frozen=True)
class Palette:
    """Which materials (their numbers) a room uses for what."""

    index: dict[str, list[int]]

    def pick(self, role: str, rng: Rng) -> int:
        """One of the role's materials."""
        return int(rng.choice(self.index[role]))


class Textures:
    """All textures of a room with their mip levels, in one flat array for one gather.

    Args:
        images: [S, S, 3] each.
        texels: metres a texel, each.
    """

    def __init__(self, images: list[np.ndarray], texels: list[float]) -> None:
        self._images = [image.astype(np.float32) for image in images]
        self._texel = np.array(texels, float)

    def add(self, image: np.ndarray, texel: float) -> int:
        """The number of one texture more, of the same size; before the first lookup only."""
        assert "_levels" not in vars(self)
        self._images.append(image.astype(np.float32))
        self._texel = np.append(self._texel, texel)
        return len(self._images) - 1

    def replace(self, number: int, image: np.ndarray, texel: float) -> None:
        """Another texture under a number; before the first lookup only."""
        assert "_levels" not in vars(self)
        self._images[number] = image.astype(np.float32)
        self._texel[number] = texel

    @cached_property
    def _levels(self) -> tuple[np.ndarray, np.ndarray]:
        """Every level of every texture [N, 3], and where a level begins."""
        level = np.stack(self._images)
        self._images = []
        flat, offsets, offset = [], [], 0
        while level.shape[1] >= 8:
            flat.append(level.reshape(-1, 3))
            offsets.append(offset)
            offset += len(flat[-1])
            n, s = level.shape[0], level.shape[1] // 2
            level = level.reshape(n, s, 2, s, 2, 3).mean(axis=(2, 4))
        return np.concatenate(flat), np.asarray(offsets)

    def lookup(self, material: np.ndarray, uv: np.ndarray, footprint: np.ndarray) -> np.ndarray:
        """Colours [N, 3] of materials [N] at uv [N, 2] (m), averaged over ``footprint`` [N] (m)."""
        flat, offsets = self._levels
        texel = self._texel[material]
        level = np.log2(np.maximum(footprint / texel, 1e-6)) + 0.3
        level = np.clip(level, 0, len(offsets) - 1).astype(np.int64)
        size = SIZE >> level
        xy = uv / (texel * (1 << level))[:, None] - 0.5
        corner = np.floor(xy)
        fx, fy = (xy - corner).astype(np.float32).T[..., None]
        x0, y0 = corner.astype(np.int64).T & (size - 1)
        x1, y1 = (x0 + 1) & (size - 1), (y0 + 1) & (size - 1)
        base = offsets[level] + material * size * size
        top = flat[base + y0 * size + x0] * (1 - fx) + flat[base + y0 * size + x1] * fx
        low = flat[base + y1 * size + x0] * (1 - fx) + flat[base + y1 * size + x1] * fx
        return top * (1 - fy) + low * fy


def make_materials(rng: Rng, rooms: int = 1) -> tuple[list[Palette], Textures]:
    """The materials of rooms: each has its own walls and floor, the others they share."""
    surround = _surround(rng)
    roles: list[Role] = [
        ("wall", surround["wall"]),
        ("accent", surround["accent"]),
        ("ceiling", lambda r: tx.plaster(r, 0.07)),
        ("floor", surround["floor"]),
        ("wood", tx.wood),
        ("wood", tx.wood),
        ("fabric", tx.fabric),
        ("fabric", tx.fabric),
        ("fabric", tx.carpet),
        ("rug", tx.rug),
        ("painted", tx.painted),
        ("rugged", tx.rugged),
        ("glaze", tx.marble),
        ("poster", tx.poster),
        ("poster", (tx.patchwork, tx.rug, tx.marble)[rng.integers(3)]),
        ("outside", tx.outside),
    ]
    index: dict[str, list[int]] = {}
    made = []
    for number, (role, maker) in enumerate(roles):
        index.setdefault(role, []).append(number)
        made.append(maker(rng))
    palettes = [Palette(index)]
    for _ in range(1, rooms):
        own = {}
        for role, maker in _surround(rng).items():
            own[role] = [len(made)]
            made.append(maker(rng))
        palettes.append(Palette({**index, **own}))
    return palettes, Textures([image for image, _ in made], [t for _, t in made])


def _surround(rng: Rng) -> dict[str, Maker]:
    """What makes the walls and the floor of a room."""
    chosen = rng.choice(len(WALLS), 2, replace=False)
    walls: list[Maker] = [WALLS[i] for i in chosen]
    if rng.random() < 0.6:  # most rooms have plain walls with one accent
        walls[0] = tx.plaster
    strength = rng.uniform(0.07, 0.16)
    return {
        "wall": lambda r: tx.plaster(r, strength) if walls[0] is tx.plaster else walls[0](r),
        "accent": walls[1],
        "floor": FLOORS[rng.integers(len(FLOORS))],
    }
