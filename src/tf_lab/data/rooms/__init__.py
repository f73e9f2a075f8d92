"""The embedded data set: seeded, procedural, furnished rooms seen by a hand-held camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tf_lab.data.rooms.arrange import furnish, hang_lamp
from tf_lab.data.rooms.borrowed import NOTHING, Borrowed
from tf_lab.data.rooms.decor import Kit
from tf_lab.data.rooms.footprint import FreeSpace, Placed
from tf_lab.data.rooms.layout import Plan, build_shell, make_plan
from tf_lab.data.rooms.materials import Textures, make_materials
from tf_lab.data.rooms.models import furniture_of
from tf_lab.data.rooms.render import Lighting, Renderer, make_lighting
from tf_lab.data.rooms.shapes import RoomGeometry, Surfaces
from tf_lab.data.rooms.walk import make_walk
from tf_lab.data.scene import Frame
from tf_lab.geometry import pinhole

VERSION: int = 4
"""Changes whenever the output for the same seed does."""

FIELD_OF_VIEW = np.radians(58.0)  # horizontal, about ScanNet's


@dataclass(frozen=True)
class RoomSettings:
    """How rooms are filmed.

    Attributes:
        width: pixels.
        height: pixels.
        frames: of each room; of a flat, so many for each of its rooms.
        samples: samples**2 rays for a pixel on an edge.
    """

    width: int = 160
    height: int = 120
    frames: int = 160
    samples: int = 2


@dataclass(frozen=True)
class Room:
    """Everything about a room but its camera."""

    plan: Plan
    placed: list[Placed]
    geometry: RoomGeometry
    textures: Textures
    lighting: Lighting


def make_room(seed: int, borrowed: Borrowed = NOTHING) -> Room:
    """The room of a seed; what is borrowed stands in for some of its furniture and textures."""
    rng = np.random.default_rng([seed, 0])
    (palette,), textures = make_materials(rng)
    if borrowed.photographs is not None:
        borrowed.photographs.cover([palette], textures, seed)
    kit = Kit(Surfaces(rng), palette, rng)
    plan = make_plan(rng)
    build_shell(kit.s, plan, palette, rng)
    placed = furnish(kit, plan, furniture=furniture_of(borrowed.furniture, textures, seed))
    lighting = make_lighting(plan, rng)
    hang_lamp(kit, lighting.positions[0], plan.height)
    return Room(plan, placed, kit.s.build(), textures, lighting)


def generate_room(
    seed: int, settings: RoomSettings, borrowed: Borrowed = NOTHING
) -> Iterator[Frame]:
    """Film the room of a seed: the same seed, settings and borrowed things, the same frames."""
    room = make_room(seed, borrowed)
    K = pinhole((settings.width, settings.height), FIELD_OF_VIEW)
    size = settings.width, settings.height
    renderer = Renderer(room.geometry, room.textures, [room.lighting], K, size, settings.samples)
    rng = np.random.default_rng([seed, 1])
    space = FreeSpace(room.plan, room.placed)
    targets = room.geometry.sample(600, rng)
    trail, filmed = make_walk(space, renderer.scene, targets, settings.frames, rng)
    poses = trail[filmed]
    for number, pose in enumerate(poses):
        image, depth = renderer.film(pose, poses[max(number - 1, 0)], rng)
        yield Frame(f"{number:06d}", image, K, pose, depth)
