"""Photographs of wood, brick, tiles, stone and cloth, in place of some painted textures.

They come from Sweet Home 3D's catalogues of textures: ``.sh3t`` files, or the program's own, in its
``sweethome3d.jar``.
"""

from __future__ import annotations

import functools
import io
import logging
import re
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from tf_lab.data.rooms.archives import Archive, digest_of, read_archive
from tf_lab.data.rooms.materials import Palette, Textures
from tf_lab.data.rooms.textures import SIZE, Texture, linear
from tf_lab.errors import TFLabError

log = logging.getLogger(__name__)
VERSION = 1  # changes whenever scenes with the same catalogue do
SUFFIX, PROGRAM = ".sh3t", "sweethome3d.jar"
LISTS = (
    "PluginTexturesCatalog.properties",
    "com/eteks/sweethome3d/io/DefaultTexturesCatalog.properties",
)
OUTDOORS = re.compile(r"sky|cloud|grass|lawn|tree|hedge|roof|asphalt|road|water|pebble|gravel|sand")
ROLES = (  # of materials, by a word in a category or a name
    (re.compile(r"wood|parquet|plank|laminate|oak|pine"), ("wood", "floor")),
    (re.compile(r"fabric|cloth|textile|leather"), ("fabric",)),
    (re.compile(r"carpet|rug"), ("fabric", "rug", "floor")),
    (re.compile(r"\bwall|brick|plaster|roughcast|stone|marble|concrete"), ("wall", "accent")),
    (re.compile(r"floor|tile|paving|terrazzo"), ("floor",)),
)
SHARE = {"wall": 0.25, "accent": 0.5, "floor": 0.5, "wood": 0.5, "fabric": 0.5, "rug": 0.5}
LEAST, MOST = 0.05, 5.0  # metres across
REPEATS = 4  # of an image along a side, at most, to make a square of it


@dataclass(frozen=True)
class Photograph:
    """An image of a catalogue.

    Attributes:
        name: as in the list.
        roles: of materials that it may be.
        maker: whom to name.
        archive: the catalogue.
        path: in it.
        size: width and height, metres.
    """

    name: str
    roles: tuple[str, ...]
    maker: str
    archive: Path
    path: str
    size: tuple[float, float]


@dataclass(frozen=True)
class Photographs:
    """Images that may cover surfaces.

    Attributes:
        images: in the order of the lists.
        licences: of each catalogue, as it states them.
        digest: of the images and lists, wherever they lie.
    """

    images: tuple[Photograph, ...]
    licences: dict[str, str]
    digest: str

    def attribution(self) -> str:
        """Who took what, under which licence: images of the scenes are to come with it."""
        lines = ["Photographs on surfaces of these scenes, from catalogues of Sweet Home 3D;"]
        lines[0] += " brightness is changed:"
        for archive, licence in self.licences.items():
            lines += ["", f"{archive}: {licence}"]
            own = [image for image in self.images if image.archive.name == archive]
            lines += sorted({f"- {image.name} ({image.path}), by {image.maker}" for image in own})
        return "\n".join(lines) + "\n"

    def cover(self, palettes: Sequence[Palette], textures: Textures, seed: int) -> None:
        """Put images in place of some materials of a scene, at random by its seed."""
        rng = np.random.default_rng([seed, 5])
        done: set[int] = set()
        for palette in palettes:
            for role, numbers in palette.index.items():
                like = [image for image in self.images if role in image.roles]
                for number in numbers:
                    if number in done or not like:
                        continue
                    done.add(number)
                    chosen, gain = like[rng.integers(len(like))], rng.uniform(0.7, 1.2)
                    if rng.random() >= SHARE[role]:
                        continue
                    texture = read_texture(chosen)
                    if texture is not None:
                        image, texel = texture
                        textures.replace(number, np.clip(gain * image, 0.02, 0.95), texel)


@functools.cache
def read_photographs(place: Path) -> Photographs:
    """The images of surfaces indoors in a catalogue, or in all of a folder.

    Raises:
        TFLabError: there is none, or a catalogue is damaged.
    """
    files = [place]
    if place.is_dir():
        files = sorted([*place.glob(f"*{SUFFIX}"), *place.glob(PROGRAM)])
    if not files or not place.exists():
        raise TFLabError(
            f"{place}: no {SUFFIX} file and no {PROGRAM}; give a folder of Sweet Home 3D's "
            "catalogues of textures, or one of them (Debian: /usr/share/sweethome3d, of the "
            "package sweethome3d)"
        )
    archives = [read_archive(path, LISTS, "catalogue of textures") for path in files]
    found = [(archive, _images(archive)) for archive in archives]
    images = tuple(image for _, own in found for image in own)
    if not images:
        raise TFLabError(f"{place}: no image in its catalogues is of a surface indoors")
    digest = digest_of((archive, {image.path for image in own}) for archive, own in found)
    licences = {archive.path.name: archive.licence for archive in archives}
    return Photographs(images, licences, digest)


def _images(archive: Archive) -> list[Photograph]:
    return [image for entry in archive.entries if (image := _image(archive, entry)) is not None]


def _image(archive: Archive, entry: dict[str, str]) -> Photograph | None:
    """The image of an entry, if it is of a surface indoors."""
    path, name = entry.get("image", "").lstrip("/"), entry.get("name", "")
    words = f"{entry.get('category', '')} {name}".lower()
    if path not in archive.infos or OUTDOORS.search(words):
        return None
    roles = {role for known, these in ROLES if known.search(words) for role in these}
    if entry.get("category", "").lower() == "wall":  # tiles and boards, too
        roles = roles & {"wood"} | {"wall", "accent"}
    elif entry.get("category", "").lower() == "floor":
        roles -= {"wall", "accent"}
    try:
        width, height = (float(entry[key]) / 100 for key in ("width", "height"))
    except (KeyError, ValueError):
        return None
    if not roles or not all(LEAST <= side <= MOST for side in (width, height)):
        return None
    maker = entry.get("creator", "unknown")
    return Photograph(name, tuple(sorted(roles)), maker, archive.path, path, (width, height))


@functools.lru_cache(maxsize=128)
def read_texture(photograph: Photograph) -> Texture | None:
    """An image as a square texture; none, with a warning, if it cannot be read.

    One that is not square is repeated along both sides until it nearly is.
    """
    try:
        with zipfile.ZipFile(photograph.archive) as file:
            picture = Image.open(io.BytesIO(file.read(photograph.path))).convert("RGB")
    except Exception as error:  # whatever a decoder trips over
        log.warning("%s: %s left out (%s)", photograph.archive.name, photograph.path, error)
        return None
    width, height = photograph.size
    counts = np.arange(1, REPEATS + 1)
    sides = np.abs(np.log(np.outer(counts, 1 / counts) * width / height))
    across, down = np.unravel_index(int(np.argmin(sides)), sides.shape)
    repeated = np.tile(np.asarray(picture), (int(down) + 1, int(across) + 1, 1))
    square = Image.fromarray(repeated).resize((SIZE, SIZE), Image.Resampling.BOX)
    return linear(np.asarray(square)), (int(across) + 1) * width / SIZE
