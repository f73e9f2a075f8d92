"""Catalogues of furniture that people modelled: Sweet Home 3D's ``.sh3f`` files.

Such a file is a zip of OBJ models with their materials and textures, and of a list that gives each
model's name, size, maker and place in a home.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tf_lab.data.rooms.archives import Archive, digest_of, read_archive
from tf_lab.errors import TFLabError

SUFFIX = ".sh3f"
LIST = "PluginFurnitureCatalog.properties"
INDOORS = {"bathroom", "bedroom", "kitchen", "lights", "living room", "miscellaneous", "office"}
LARGEST = 1_500_000  # bytes of an OBJ file; finer shapes are lost on our images


@dataclass(frozen=True)
class Kind:
    """What may stand in for a piece of ours.

    Attributes:
        words: of which one is in its name (a regular expression).
        low, high: of its width, depth and height, metres.
    """

    words: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]


KINDS = {  # the first that fits
    "armchair": Kind(r"armchair", (0.5, 0.5, 0.6), (1.2, 1.2, 1.2)),
    "bed": Kind(r"\bbed\b|futon", (0.7, 1.7, 0.15), (2.1, 2.4, 1.7)),
    "chair": Kind(r"\b(chair|seat)\b", (0.35, 0.35, 0.6), (0.8, 0.85, 1.2)),
    "nightstand": Kind(r"bedside|filing", (0.3, 0.3, 0.3), (0.65, 0.6, 0.7)),
    "coffee table": Kind(r"table\b", (0.45, 0.4, 0.25), (1.5, 1.0, 0.6)),
    "desk": Kind(r"\bdesk\b", (0.9, 0.5, 0.65), (2.0, 0.9, 1.4)),
    "floor lamp": Kind(r"lamp", (0.15, 0.15, 1.1), (0.8, 0.8, 2.0)),
    "fridge": Kind(r"fridge|refrigerator|high cabinet", (0.5, 0.5, 1.1), (1.0, 1.0, 2.2)),
    "plant": Kind(r"plant|yucca|cactus|bamboo|ficus|palm", (0.2, 0.2, 0.3), (1.2, 1.2, 2.0)),
    "pouf": Kind(r"stool|bench|ottoman|pouf", (0.25, 0.25, 0.3), (1.2, 0.8, 1.1)),
    "shelf": Kind(r"shel(f|ves)|bookcase|shelving", (0.4, 0.2, 0.7), (1.9, 0.6, 2.25)),
    "sideboard": Kind(
        r"dresser|cabinet|chest|stand|vanity|cupboard", (0.6, 0.3, 0.4), (1.9, 0.75, 1.5)
    ),
    "sofa": Kind(r"sofa|couch", (1.2, 0.6, 0.5), (2.6, 1.2, 1.1)),
    "table": Kind(r"table\b", (0.6, 0.6, 0.65), (2.4, 1.3, 0.95)),
    "wardrobe": Kind(r"wardrobe|closet", (0.8, 0.4, 1.6), (2.2, 0.75, 2.4)),
}
OTHER = "crates"  # stand for whatever else is found on floors
OTHERS = Kind(r"", (0.25, 0.2, 0.25), (1.7, 0.9, 2.0))
HANGING = re.compile(r"curtain|blind|clothes$|hanger|railing|fence|door|window", re.IGNORECASE)


@dataclass(frozen=True)
class Model:
    """A model of a catalogue.

    Attributes:
        name: as in the list.
        kind: of `KINDS`, or `OTHER`.
        maker: whom to name.
        archive: the catalogue.
        path: of the OBJ file in it.
        size: width, depth, height, metres.
        rotation: of the file's axes before it is fitted into its size, [9] row by row.
    """

    name: str
    kind: str
    maker: str
    archive: Path
    path: str
    size: tuple[float, float, float]
    rotation: tuple[float, ...]


@dataclass(frozen=True)
class Catalogue:
    """Models that may stand in rooms.

    Attributes:
        models: in the order of the lists.
        licences: of each catalogue, as it states them.
        digest: of what is in the catalogues, wherever they lie.
    """

    models: tuple[Model, ...]
    licences: dict[str, str]
    digest: str

    def of_kind(self, kind: str) -> list[Model]:
        """Those that may stand in for a piece of ours of that name."""
        return [model for model in self.models if model.kind == kind]

    def attribution(self) -> str:
        """Who made what, under which licence: images of the models are to come with it."""
        lines = [
            "Furniture in these scenes, from catalogues of Sweet Home 3D; materials are changed:"
        ]
        for archive, licence in self.licences.items():
            lines += ["", f"{archive}: {licence}"]
            own = [model for model in self.models if model.archive.name == archive]
            lines += sorted({f"- {model.name} ({model.path}), by {model.maker}" for model in own})
        return "\n".join(lines) + "\n"


@functools.cache
def read_catalogue(directory: Path) -> Catalogue:
    """The models of all catalogues in a folder that stand on the floor of a home.

    Raises:
        TFLabError: there is none, or one is damaged.
    """
    files = sorted(directory.glob(f"*{SUFFIX}"))
    if not files:
        raise TFLabError(
            f"{directory}: no {SUFFIX} file inside; give the folder of Sweet Home 3D's furniture "
            "catalogues (Debian: the package sweethome3d-furniture)"
        )
    archives = [read_archive(path, [LIST], "furniture catalogue") for path in files]
    models = [
        model
        for archive in archives
        for entry in archive.entries
        if (model := _model(archive, entry)) is not None
    ]
    if not models:
        raise TFLabError(f"{directory}: no model in its catalogues stands on the floor of a home")
    licences = {archive.path.name: archive.licence for archive in archives}
    digest = digest_of((archive, archive.infos) for archive in archives)
    return Catalogue(tuple(models), licences, digest)


def _model(archive: Archive, entry: dict[str, str]) -> Model | None:
    """The model of an entry, if it is one for floors and no larger than is of use."""
    path = entry.get("model", "").lstrip("/")
    if entry.get("category", "").lower() not in INDOORS or path not in archive.infos:
        return None
    if not path.lower().endswith(".obj") or archive.infos[path].file_size > LARGEST:
        return None
    try:
        size = tuple(float(entry[key]) / 100 for key in ("width", "depth", "height"))
        raised = float(entry.get("elevation", 0))
        rotation = tuple(map(float, entry.get("modelRotation", "1 0 0 0 1 0 0 0 1").split()))
    except (KeyError, ValueError):
        return None
    name = entry.get("name", path)
    if raised > 0 or entry.get("doorOrWindow") == "true" or HANGING.search(name):
        return None
    kind = _kind(name.lower(), np.array(size))
    if kind is None or len(rotation) != 9:
        return None
    maker = entry.get("creator", "unknown")
    return Model(name, kind, maker, archive.path, path, (size[0], size[1], size[2]), rotation)


def _kind(name: str, size: np.ndarray) -> str | None:
    """Which piece of ours a model is like."""
    known = [kind for kind, of in KINDS.items() if re.search(of.words, name)]
    for kind in known:
        if np.all(size >= KINDS[kind].low) and np.all(size <= KINDS[kind].high):
            return kind
    odd = np.any(size < OTHERS.low) or np.any(size > OTHERS.high)
    return None if known or odd else OTHER
