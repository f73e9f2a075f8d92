"""Image files of the sources: which there are, in which order, under which names, how large."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePath

from PIL import Image

from tf_lab.data.lens import Camera
from tf_lab.errors import TFLabError

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")


def is_file(path: Path) -> bool:
    """Whether a file is there, whatever a source's text made of its path."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # no possible name
        return False


def image_files(directory: Path) -> list[Path]:
    """The visible JPEG and PNG files of a directory, in natural order (img2 before img10)."""
    files = (path for path in directory.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    return sorted((path for path in files if not path.name.startswith(".")), key=natural_order)


def natural_order(path: PurePath) -> tuple[list[list[tuple[str, int, str]]], str]:
    """A key to sort paths by, folder by folder, with the numbers in them as numbers."""
    return [_natural(part) for part in (*path.parent.parts, path.stem)], str(path)


def _natural(text: str) -> list[tuple[str, int, str]]:
    # alternating words and digits; of two numbers, that with more digits is larger
    parts = ((word.lower(), digits) for word, digits in re.findall(r"(\D*)(\d*)", text))
    return [(word, len(d.lstrip("0")) if d else -1, d.lstrip("0")) for word, d in parts]


def frame_names(files: Sequence[PurePath]) -> list[str]:
    """Names for the frames of image files: unique and usable as file names."""
    stems = [file.stem for file in files]
    paths = [
        "_".join(p for p in (file.parent / file.stem).parts if p.strip("./")) for file in files
    ]
    numbered = [f"{number}_{stem}" for number, stem in enumerate(stems)]
    return next(names for names in (stems, paths, numbered) if len(set(names)) == len(names))


def image_size(paths: Iterable[Path]) -> tuple[int, int]:
    """(width, height) by the first header that can be read; nothing is decoded.

    Raises:
        TFLabError: none can be read.
    """
    last = None
    for last in paths:
        try:
            with Image.open(last) as image:
                return image.size
        except Exception:  # damaged data makes Pillow raise nearly anything
            continue  # the capture reports this file when its image is asked for
    raise TFLabError(f"{last}: not one of the colour images can be read; use JPEG or PNG")


def at_file_size(cameras: Sequence[Camera], files: Sequence[Path]) -> list[Camera]:
    """The cameras of image files that may have been resized after their intrinsics were written.

    One header is read for each size of camera.

    Raises:
        TFLabError: the images have another shape, or none can be read.
    """
    by_size = defaultdict(list)
    for camera, file in zip(cameras, files, strict=True):
        by_size[camera.size].append(file)
    sizes = {size: image_size(those) for size, those in by_size.items()}
    for (width, height), (w, h) in sizes.items():
        if abs(w * height - h * width) > max(width, height):  # more than rounding to whole pixels
            raise TFLabError(
                f"{by_size[width, height][0].parent}: the images are {w}x{h}, their camera "
                f"{width}x{height}, of another shape; give the images that the intrinsics are of"
            )
    resized = {camera: camera.resized(sizes[camera.size]) for camera in set(cameras)}
    return [resized[camera] for camera in cameras]
