"""Modelled furniture in a room, in place of pieces of ours."""

from __future__ import annotations

import functools
import io
import logging
import zipfile
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from tf_lab.data.rooms.catalogue import Catalogue, Model
from tf_lab.data.rooms.decor import Kit, Piece
from tf_lab.data.rooms.materials import Textures
from tf_lab.data.rooms.textures import SIZE, linear

log = logging.getLogger(__name__)
VERSION = 1  # changes whenever scenes with the same catalogue do
SHARE = 0.6  # of pieces that a model stands in for
SAME = 0.7  # of those that are the same model as the last of their kind: chairs of one table
OPAQUE = 0.5  # of less opacity are panes, which are left out
SMALLEST = 1e-8  # square metres of a triangle


@dataclass(frozen=True)
class Part:
    """Triangles [F, 3, 3] (metres, in the piece's frame) of one material.

    Attributes:
        corners: float64 [F, 3, 3].
        colour: linear [3].
        uv: [F, 3, 2] in widths of the image, v upwards; None without an image.
        image: linear float32 [SIZE, SIZE, 3], or None.
        pane: whether one sees through it.
    """

    corners: np.ndarray
    colour: np.ndarray
    uv: np.ndarray | None
    image: np.ndarray | None
    pane: bool


class Furniture:
    """Models that stand in for pieces of a scene.

    Args:
        catalogue: where they are from.
        textures: of the scene, to which theirs are added.
        rng: the random source.
    """

    def __init__(self, catalogue: Catalogue, textures: Textures, rng: np.random.Generator) -> None:
        self._catalogue, self._textures, self._rng = catalogue, textures, rng
        self._last: dict[str, Model] = {}
        self._materials: dict[tuple[Model, int], tuple[int, float]] = {}

    def instead(self, piece: Piece) -> Piece:
        """A model for a piece of ours, or that piece."""
        like = self._catalogue.of_kind(piece.name)
        if not like or self._rng.random() >= SHARE:
            return piece
        model = like[self._rng.integers(len(like))]
        if piece.name in self._last and self._rng.random() < SAME:
            model = self._last[piece.name]
        parts = read_parts(model)
        if not parts:
            return piece
        self._last[piece.name] = model
        width, depth, height = model.size

        def build(kit: Kit) -> None:
            for number, part in enumerate(parts):
                self._add(kit, part, (model, number))

        return Piece(piece.name, width, depth, height, build)

    def _add(self, kit: Kit, part: Part, key: tuple[Model, int]) -> None:
        if part.image is None or part.uv is None:
            kit.s.triangles(part.corners, kit.painted, part.colour)
            return
        if key not in self._materials:
            across = _metres(part.corners, part.uv)
            self._materials[key] = self._textures.add(part.image, across / SIZE), across
        material, across = self._materials[key]
        uv = part.uv * [1, -1] * across  # rows go down
        kit.s.triangles(part.corners, material, (1.0, 1.0, 1.0), uv)


def furniture_of(catalogue: Catalogue | None, textures: Textures, seed: int) -> Furniture | None:
    """The modelled furniture of the scene of a seed, if there is a catalogue."""
    if catalogue is None:
        return None
    return Furniture(catalogue, textures, np.random.default_rng([seed, 4]))


@functools.lru_cache(maxsize=64)
def read_parts(model: Model) -> tuple[Part, ...]:
    """The parts of a model in a piece's frame; none, with a warning, if it cannot be read."""
    try:
        folder = model.path[: model.path.rfind("/") + 1]
        with zipfile.ZipFile(model.archive) as file:
            beside = [name for name in file.namelist() if name.startswith(folder)]
            files = {name: io.BytesIO(file.read(name)) for name in beside}
        resolver = trimesh.resolvers.ZipResolver(files, namespace=folder or None)
        scene = trimesh.load_scene(files[model.path], "obj", resolver=resolver, process=False)
        made = [_part(mesh) for mesh in scene.geometry.values()]
    except Exception as error:  # whatever a parser trips over
        log.warning("%s: %s left out (%s)", model.archive.name, model.path, error)
        return ()
    return _fitted([part for part in made if len(part.corners)], model)


def _part(mesh: trimesh.Trimesh) -> Part:
    """A mesh of a file as a part, in the file's frame."""
    material: Any = getattr(mesh.visual, "material", None)
    said = getattr(material, "kwargs", None) or {}
    pane = float(said.get("d", ["1"])[0]) < OPAQUE
    corners = np.asarray(mesh.vertices, float)[mesh.faces]
    diffuse = getattr(material, "diffuse", None)
    colour = np.array([200, 200, 200]) if diffuse is None else np.asarray(diffuse)[:3]
    picture, uv = getattr(material, "image", None), getattr(mesh.visual, "uv", None)
    if picture is None or uv is None:
        return Part(corners, linear(colour), None, None, pane)
    small = picture.convert("RGB").resize((SIZE, SIZE), Image.Resampling.BILINEAR)
    image = linear(np.asarray(small))
    return Part(corners, linear(colour), np.asarray(uv)[mesh.faces], image, pane)


def _fitted(parts: list[Part], model: Model) -> tuple[Part, ...]:
    """Parts in the frame of a piece: x to its right, y to its front, z up, in its size.

    A file's y is up and its front faces z, so that x is turned round. Panes are left out.
    """
    if not parts:
        return ()
    turn = np.array([[-1, 0, 0], [0, 0, 1], [0, 1, 0.0]]) @ np.reshape(model.rotation, (3, 3))
    turned = [part.corners @ turn.T for part in parts]
    low = np.min([corners.min((0, 1)) for corners in turned], axis=0)
    high = np.max([corners.max((0, 1)) for corners in turned], axis=0)
    scale = np.array(model.size) / np.maximum(high - low, 1e-9)
    found = []
    for part, corners in zip(parts, turned, strict=True):
        placed = (corners - low) * scale
        big = _areas(placed) > SMALLEST
        uv = None if part.uv is None else part.uv[big]
        found.append(replace(part, corners=placed[big], uv=uv))
    return tuple(part for part in found if len(part.corners) and not part.pane)


def _metres(corners: np.ndarray, uv: np.ndarray) -> float:
    """How wide an image is on a part."""
    flat = np.concatenate([uv, np.zeros((*uv.shape[:2], 1))], axis=2)
    return float(np.sqrt(_areas(corners).sum() / max(_areas(flat).sum(), 1e-9)).clip(0.01, 20))


def _areas(corners: np.ndarray) -> np.ndarray:
    a, b, c = corners.transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
