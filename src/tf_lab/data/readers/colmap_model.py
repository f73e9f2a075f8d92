"""The files of COLMAP's sparse models: cameras and images, text or binary; points are not read.

See https://colmap.github.io/format.html. Binary numbers are little-endian. Every count in a file is
held against the file's size before anything is read by it.
"""

from __future__ import annotations

import codecs
import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tf_lab.data.lens import Camera
from tf_lab.errors import TFLabError

CURE = "write the model again with COLMAP's model_converter"
MAX_LINE = 2**24  # bytes; a line may hold all the points of an image

_IMAGE_SIZE = 73  # bytes at least of an image in images.bin
_FISHEYE = "FISHEYE"  # of the models' names
_MODELS = {
    "SIMPLE_PINHOLE": (0, "f cx cy"),
    "PINHOLE": (1, "fx fy cx cy"),
    "SIMPLE_RADIAL": (2, "f cx cy k1"),
    "RADIAL": (3, "f cx cy k1 k2"),
    "OPENCV": (4, "fx fy cx cy k1 k2 p1 p2"),
    "OPENCV_FISHEYE": (5, "fx fy cx cy k1 k2 k3 k4"),
    "FULL_OPENCV": (6, "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"),
    "SIMPLE_RADIAL_FISHEYE": (8, "f cx cy k1"),
    "RADIAL_FISHEYE": (9, "f cx cy k1 k2"),
    "SIMPLE_FISHEYE": (14, "f cx cy"),
    "FISHEYE": (15, "fx fy cx cy"),
}
_OTHER_MODELS = {  # for the message
    7: "FOV", 10: "THIN_PRISM_FISHEYE", 11: "RAD_TAN_THIN_PRISM_FISHEYE", 12: "SIMPLE_DIVISION",
    13: "DIVISION", 16: "EUCM", 17: "EQUIRECTANGULAR",
}  # fmt: skip
_OTHER_COUNTS = {"FOV": 5, "THIN_PRISM_FISHEYE": 12, "RAD_TAN_THIN_PRISM_FISHEYE": 16}  # parameters
_NAMES = {number: name for name, (number, _) in _MODELS.items()} | _OTHER_MODELS


@dataclass(frozen=True)
class ModelImage:
    """An image of a model: its file, its camera's id, cam_T_world as quaternion wxyz and xyz."""

    name: str
    camera: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]


class _RefusedError(ValueError):
    """A camera that is written as it should be, and cannot be used."""


def has_model(folder: Path) -> bool:
    """Whether a folder holds a sparse model."""
    return _suffix(folder) is not None


def count_images(folder: Path) -> int:
    """How many images a model has; 0 if that cannot be told."""
    try:
        if _suffix(folder) == ".bin":
            return _Bytes(folder / "images.bin").count(size=_IMAGE_SIZE)
        lines = (line for _, line in _lines(folder / "images.txt") if not line.startswith("#"))
        return sum(1 for _ in lines) // 2
    except (OSError, ValueError):
        return 0


def read_model(folder: Path) -> tuple[dict[int, Camera | str], list[ModelImage]]:
    """The cameras of a model by their ids, and its images; binary where there are both.

    Returns:
        Cameras, or why one cannot be used; the images.

    Raises:
        TFLabError: a file is missing or damaged, or no camera can be used.
    """
    suffix = _suffix(folder) or ".bin"
    read_cameras, read_images = {
        ".bin": (_binary_cameras, _binary_images),
        ".txt": (_text_cameras, _text_images),
    }[suffix]
    file = folder / f"cameras{suffix}"
    try:
        cameras = dict(read_cameras(file))
        refused = [why for why in cameras.values() if isinstance(why, str)]
        if refused and len(refused) == len(cameras):
            raise TFLabError(f"{file}: {refused[0]}")
        file = folder / f"images{suffix}"
        images = list(read_images(file))
    except (OSError, ValueError) as error:  # struct.error is none: all reads are checked
        reason = error.strerror if isinstance(error, OSError) else error
        raise TFLabError(f"{file}: {reason}; {CURE}") from error
    return cameras, images


def _suffix(folder: Path) -> str | None:
    for suffix in (".bin", ".txt"):
        if all((folder / f"{name}{suffix}").is_file() for name in ("cameras", "images")):
            return suffix
    return None


def _camera(model: str, size: tuple[int, int], values: tuple[float, ...]) -> Camera:
    """A camera, with COLMAP's pixel centres, which are at 0.5, turned into ours."""
    if model not in _MODELS:
        raise _RefusedError(
            f"the camera model {model[:40]} is not supported; undistort the images with colmap "
            f"image_undistorter, or estimate one of {', '.join(_MODELS)}"
        )
    names = _MODELS[model][1].split()
    if len(values) != len(names):
        raise ValueError(f"a {model} camera has {len(values)} parameters, not {len(names)}")
    given = dict(zip(names, values, strict=True))
    fisheye = _FISHEYE in model
    keys = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    distortion = tuple(given.get(key, 0.0) for key in keys)
    fx, fy = given.get("fx", given.get("f", 0.0)), given.get("fy", given.get("f", 0.0))
    try:
        return Camera(
            size, fx, fy, given["cx"] - 0.5, given["cy"] - 0.5,
            distortion if any(distortion) else (), fisheye,
        )  # fmt: skip
    except TFLabError as error:
        raise _RefusedError(f"a {model} camera: {error}") from error


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """The numbered lines of a text that may be large."""
    with path.open("rb") as file:
        wide = file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # Windows' editors
    with path.open(encoding="utf-16" if wide else "utf-8-sig") as file:
        number = 0
        while line := file.readline(MAX_LINE):
            number += 1
            yield number, line.strip()


def _text_cameras(path: Path) -> Iterator[tuple[int, Camera | str]]:
    for number, line in _lines(path):
        if not line or line.startswith("#"):
            continue
        try:
            name, model, width, height, *values = line.split()
            size = int(width), int(height)
            yield int(name), _camera(model, size, tuple(float(value) for value in values))
        except _RefusedError as error:
            yield int(name), f"line {number}: {error}"
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from error


def _text_images(path: Path) -> Iterator[ModelImage]:
    lines = _lines(path)
    for number, line in lines:
        if not line or line.startswith("#"):
            continue
        words = line.split(maxsplit=9)
        try:
            numbers = tuple(float(word) for word in words[1:8])
            image = ModelImage(words[9], int(words[8]), numbers[:4], numbers[4:])
        except (ValueError, IndexError):
            raise ValueError(
                f"line {number}: {line[:60]!r} is no image "
                "(id, qw, qx, qy, qz, tx, ty, tz, camera, name)"
            ) from None
        _, points = next(lines, (0, ""))  # the line of its points, often empty
        if points and not points.rsplit(maxsplit=1)[-1].lstrip("-").isdigit():
            raise ValueError(f"line {number + 1}: the line of the image's points is missing")
        yield image


class _Bytes:
    """A binary file that is read in order, and never beyond its end."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            # of an empty file there is no map
            self._data = (
                mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if path.stat().st_size else b""
            )
        self._offset = 0

    def numbers(self, layout: str) -> tuple[Any, ...]:
        """The next values of a `struct` layout."""
        start, self._offset = self._offset, self._offset + struct.calcsize(layout)
        if self._offset > len(self._data):
            raise ValueError("it ends too early (truncated?)")
        return struct.unpack_from(layout, self._data, start)

    def count(self, size: int) -> int:
        """The next number, a count of things of at least ``size`` bytes each."""
        (count,) = self.numbers("<Q")
        if count * size > len(self._data) - self._offset:
            raise ValueError(f"it cannot hold {count} entries (damaged?)")
        return int(count)

    def text(self) -> str:
        """The next text, up to a zero byte."""
        end = self._data.find(b"\0", self._offset)
        if end < 0:
            raise ValueError("a name in it has no end (damaged?)")
        text = self._data[self._offset : end]
        self._offset = end + 1
        return text.decode("utf-8", errors="replace")

    def skip(self, count: int) -> None:
        """Leave out bytes that `count` has found to be there."""
        self._offset += count


def _binary_cameras(path: Path) -> Iterator[tuple[int, Camera | str]]:
    data = _Bytes(path)
    for _ in range(data.count(size=24)):
        name, number, width, height = data.numbers("<IiQQ")
        model = _NAMES.get(number, f"number {number}")
        if model not in _MODELS and model not in _OTHER_COUNTS:  # where it ends, nobody knows
            _camera(model, (width, height), ())
        parameters = len(_MODELS[model][1].split()) if model in _MODELS else _OTHER_COUNTS[model]
        values = data.numbers(f"<{parameters}d")
        try:
            yield name, _camera(model, (width, height), values)
        except _RefusedError as error:
            yield name, str(error)


def _binary_images(path: Path) -> Iterator[ModelImage]:
    data = _Bytes(path)
    for _ in range(data.count(size=_IMAGE_SIZE)):
        _, *numbers, camera = data.numbers("<I7dI")
        name = data.text()
        data.skip(data.count(size=24) * 24)
        yield ModelImage(name, camera, tuple(numbers[:4]), tuple(numbers[4:]))
