"""Image files of the sources: which there are, in which order, under which names, how large."""

from __future__ import annotations

import logging
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from decimal import Decimal
from pathlib import Path, PurePath
from typing import TypeVar

from PIL import Image

from tf_lab.data.capture import upright_size
from tf_lab.data.lens import Camera
from tf_lab.errors import TFLabError
from tf_lab.support.words import natural

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
DEPTH_SUFFIXES = (".png", ".npy", ".tif", ".tiff")
MAX_HEADERS = 100  # of a capture's images are read to tell their size
OFF_CENTRE = 0.1  # of the image: principal points are nearer to its middle
_NUMBERS = re.compile(r"\d+")
_DECIMAL = re.compile(r"(\d+)\.(\d+)")

T = TypeVar("T")

logger = logging.getLogger(__name__)


def is_file(path: Path) -> bool:
    """Whether a file is there, whatever a source's text made of its path."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # no possible name
        return False


def image_files(directory: Path) -> list[Path]:
    """The visible JPEG and PNG files of a directory, in natural order (img2 before img10).

    Raises:
        TFLabError: the directory cannot be read.
    """
    return _files(directory, IMAGE_SUFFIXES)


def _files(directory: Path, suffixes: Sequence[str]) -> list[Path]:
    try:
        files = [path for path in directory.iterdir() if path.suffix.lower() in suffixes]
    except OSError as error:
        raise TFLabError(f"{directory}: cannot be read ({error.strerror})") from error
    return in_order([path for path in files if not path.name.startswith(".")], lambda path: path)


def natural_order(path: PurePath) -> tuple[list[list[tuple[str, int, str]]], str]:
    """A key to sort paths by, folder by folder, with the numbers in them as numbers."""
    return [natural(part) for part in (*path.parent.parts, path.stem)], str(path)


def in_order(items: Sequence[T], path: Callable[[T], PurePath]) -> list[T]:
    """Items in the natural order of their files, which for names that are seconds is that of time.

    Seconds lose the zeros at the end (1.05, 1.1): a zero before other digits after the point, in
    names of several lengths, tells them from counters (1.9, 1.10).
    """
    found = [_DECIMAL.fullmatch(path(item).stem) for item in items]
    fractions = [match[2] for match in found if match]
    zeros = any(f.startswith("0") and len(f) > 1 for f in fractions)
    if len(fractions) == len(items) and zeros and len({*map(len, fractions)}) > 1:
        return sorted(items, key=lambda item: (Decimal(path(item).stem), str(path(item))))
    return sorted(items, key=lambda item: natural_order(path(item)))


def frame_names(files: Sequence[PurePath]) -> list[str]:
    """Names for the frames of image files: unique and usable as file names."""
    stems = [file.stem for file in files]
    paths = [
        "_".join(p for p in (file.parent / file.stem).parts if p.strip("./")) for file in files
    ]
    numbered = [f"{number}_{stem}" for number, stem in enumerate(stems)]
    return next(names for names in (stems, paths, numbered) if len(set(names)) == len(names))


def image_size(paths: Sequence[Path], centre: tuple[float, float] | None = None) -> tuple[int, int]:
    """(width, height) of most of the images, by some of their headers; nothing is decoded.

    Args:
        paths: the image files.
        centre: the principal point (x, y) of their intrinsics, pixels: sizes that it is in the
            middle of go first, also that of JPEGs after turning them as their EXIF data asks for.

    Raises:
        TFLabError: none can be read.
    """
    sizes = _common_sizes(paths)
    fitting = (size for size in sizes if centre is not None and is_central(centre, size))
    return next(fitting, sizes[0])


def is_central(point: tuple[float, float], size: tuple[int, int]) -> bool:
    """Whether a principal point (x, y) may be that of images of (width, height) ``size``."""
    sides = zip(point, size, strict=True)
    return all(abs((x + 0.5) / side - 0.5) < OFF_CENTRE for x, side in sides)


def _common_sizes(paths: Sequence[Path]) -> list[tuple[int, int]]:
    """The sizes of images, the commonest first; that of a JPEG as stored, and as turned by EXIF."""
    found: Counter[tuple[int, int]] = Counter()
    for those in (paths[:: 1 + len(paths) // MAX_HEADERS], paths):
        for path in those:
            try:
                with Image.open(path) as image:
                    sizes = [image.size, upright_size(image)]
            except Exception:  # damaged data makes Pillow raise nearly anything
                continue  # the capture reports this file when its image is asked for
            found.update(sizes[: len(set(sizes))])
        if found:
            return [size for size, _ in found.most_common()]
    last = paths[-1] if paths else None
    raise TFLabError(f"{last}: not one of the colour images can be read; use JPEG or PNG")


def at_file_size(cameras: Sequence[Camera], files: Sequence[Path]) -> list[Camera]:
    """The cameras of image files that may have been resized after their intrinsics were written.

    Most of the files of each size of camera decide; the others are told when they are read.

    Raises:
        TFLabError: the images of every camera have another shape, or none can be read. Those of
            single cameras are told when they are read.
    """
    by_size = defaultdict(list)
    for camera, file in zip(cameras, files, strict=True):
        by_size[camera.size].append(file)
    sizes, refused = {}, []
    for size, those in by_size.items():
        try:
            sizes[size] = _size_of_shape(those, size)
        except TFLabError as error:
            sizes[size] = size
            refused.append(error)
    if refused and len(refused) == len(by_size):
        raise refused[0]
    resized = {camera: camera.resized(sizes[camera.size]) for camera in set(cameras)}
    return [resized[camera] for camera in cameras]


def _size_of_shape(files: Sequence[Path], shape: tuple[int, int]) -> tuple[int, int]:
    """The commonest size of images that are (width, height) ``shape``, maybe resized."""
    width, height = shape
    sizes = _common_sizes(files)
    for w, h in sizes:
        if abs(w * height - h * width) <= max(width, height):  # rounding to whole pixels
            return w, h
    raise TFLabError(
        f"{files[0].parent}: the images are {sizes[0][0]}x{sizes[0][1]}, their camera "
        f"{width}x{height}, of another shape; give the images that the intrinsics are of"
    )


def match_depths(folder: Path, images: Sequence[Path]) -> dict[Path, Path]:
    """The depth files in a folder by the images they belong to; there may be none.

    They go by equal stems, else by the last number in the names if that finds an image for each,
    else, if there are as many, by their order; a warning says so, and what is left over.
    """
    files = _files(folder, DEPTH_SUFFIXES) if folder.is_dir() else []
    found = _paired(images, files, lambda path: path.stem)
    if not found:
        by_number = _paired(images, files, _last_number)
        found = by_number if len(by_number) == len(files) else {}  # else they count otherwise
    if files and not found and len(files) == len(images):
        logger.warning("%s: its files are taken for the images' by their order", folder)
        found = dict(zip(images, files, strict=True))
    if files and not found:
        logger.warning(
            "%s: not used: %d depth files, %d images, and names as %s and %s do not tell which "
            "belong together; give them the images' stems",
            *(folder, len(files), len(images), files[0].name, images[0].name),
        )
    elif len(found) < len(files):
        logger.warning("%s: %d of its files belong to no image", folder, len(files) - len(found))
    elif folder.is_dir() and not files and any(folder.iterdir()):
        logger.warning("%s: not used: none of %s in it", folder, ", ".join(DEPTH_SUFFIXES))
    return found


def _last_number(path: Path) -> str:
    """As digits without leading zeros; empty without one."""
    numbers = _NUMBERS.findall(path.stem)
    return str(int(numbers[-1])) if numbers else ""


def _paired(
    images: Sequence[Path], depths: Sequence[Path], key: Callable[[Path], str]
) -> dict[Path, Path]:
    """Files of one key; none, if keys are not unique."""
    by_key = {key(path): path for path in depths}
    keys = [key(path) for path in images]
    if len(by_key) < len(depths) or len(set(keys)) < len(keys) or "" in by_key:
        return {}
    pairs = zip(images, keys, strict=True)
    return {image: by_key[k] for image, k in pairs if k in by_key}
