"""The embedded flats: rooms with passages between them, filmed by a phone on a walk through all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tf_lab.data.flats.contents import furnish_room, tops
from tf_lab.data.flats.phone import Filming, Phone, make_phone, motion_at, pass_times
from tf_lab.data.flats.plan import FlatPlan, make_flat_plan
from tf_lab.data.rooms import RoomSettings
from tf_lab.data.rooms.arrange import THEMES, hang_lamp
from tf_lab.data.rooms.borrowed import NOTHING, Borrowed
from tf_lab.data.rooms.decor import Kit
from tf_lab.data.rooms.footprint import FreeSpace, Placed
from tf_lab.data.rooms.layout import Plan, build_shell
from tf_lab.data.rooms.materials import Textures, make_materials
from tf_lab.data.rooms.models import furniture_of
from tf_lab.data.rooms.render import Lighting, Renderer, make_lighting
from tf_lab.data.rooms.shapes import RoomGeometry, Surfaces
from tf_lab.data.rooms.walk import Habits, make_walk
from tf_lab.data.scene import Frame
from tf_lab.geometry import pinhole

VERSION: int = 2
"""Changes whenever the output for the same seed does."""

CHEST, EYES = 1.1, 1.7  # metres, between which the camera is held
INSIDE = 0.2  # metres from the edge of a table that what is looked at lies


@dataclass(frozen=True)
class Flat:
    """Everything about a flat but its camera."""

    plan: FlatPlan
    placed: list[Placed]
    geometry: RoomGeometry
    textures: Textures
    lighting: list[Lighting]

    def space(self) -> FreeSpace:
        """Where a camera has room."""
        passages = [passage.rect for passage in self.plan.passages]
        return FreeSpace(self.plan.floor, self.placed, passages)


def make_flat(seed: int, borrowed: Borrowed = NOTHING) -> Flat:
    """The flat of a seed; what is borrowed stands in for some of its furniture and textures."""
    rng = np.random.default_rng([seed, 2])
    plan = make_flat_plan(rng)
    palettes, textures = make_materials(rng, len(plan.rooms))
    if borrowed.photographs is not None:
        borrowed.photographs.cover(palettes, textures, seed)
    surfaces = Surfaces(rng)
    furniture = furniture_of(borrowed.furniture, textures, seed)
    themes = rng.permutation(list(THEMES))
    placed: list[Placed] = []
    lighting = []
    for number, room in enumerate(plan.rooms):
        surfaces.room = number
        kit = Kit(surfaces, palettes[number], rng)
        build_shell(surfaces, room, palettes[number], rng)
        stands = furnish_room(kit, plan, number, str(themes[number]), furniture)
        lighting.append(_light(room, stands, rng))
        hang_lamp(kit, lighting[-1].positions[0], room.height)
        placed += stands
    return Flat(plan, placed, surfaces.build(), textures, lighting)


def _light(room: Plan, placed: list[Placed], rng: np.random.Generator) -> Lighting:
    """Lights of which the lamp hangs in nothing that stands on the floor."""
    tall = [piece for piece in placed if piece.height > 1.9]
    for _ in range(20):
        lighting = make_lighting(room, rng)
        beside = lighting.positions[0, :2] + 0.27 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        if not any(piece.contains(beside).any() for piece in tall):
            break
    return lighting


def generate_flat(
    seed: int, settings: RoomSettings, borrowed: Borrowed = NOTHING
) -> Iterator[Frame]:
    """Film the flat of a seed: the same seed, settings and borrowed things, the same frames."""
    flat = make_flat(seed, borrowed)
    frames = settings.frames * len(flat.plan.rooms)
    rng = np.random.default_rng([seed, 3])
    phone = make_phone(rng)
    size = settings.width, settings.height
    K = pinhole(size, phone.field_of_view)
    renderer = Renderer(flat.geometry, flat.textures, flat.lighting, K, size, settings.samples)
    targets = flat.geometry.sample(400 * len(flat.plan.rooms) + 200, rng)
    space = flat.space()
    habits = make_habits(flat, space, phone)
    trail, filmed = make_walk(space, renderer.scene, targets, frames, rng, habits)
    times = pass_times(trail, phone.pace)
    filming = Filming(phone, renderer, K, frames, rng)
    for number, i in enumerate(filmed):
        image, depth = filming.frame(number, trail[i], motion_at(trail, times, i))
        yield Frame(f"{number:06d}", image, K, trail[i], depth)


def make_habits(flat: Flat, space: FreeSpace, phone: Phone) -> Habits:
    """Through all passages, and to what is worth a closer look."""
    reach = np.array([passage.centre for passage in flat.plan.passages]).reshape(-1, 2)
    cells = space.centres(space.walkable(0.4))
    tables, stands = [], []
    for piece, top in tops(flat.placed):
        spots = piece.nearest(cells, INSIDE)
        away = np.hypot(np.linalg.norm(cells - spots, axis=1), max(phone.height - 0.1 - top, 0.5))
        best = int(np.argmin(away))
        if away[best] < 1.2:
            tables.append([*spots[best], top])
            stands.append(cells[best])
    return Habits(
        (phone.height, CHEST, EYES),
        reach,
        tuple(room.rects[0] for room in flat.plan.rooms),
        np.array(tables).reshape(-1, 3),
        np.array(stands).reshape(-1, 2),
    )
