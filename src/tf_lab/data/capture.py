"""What every source of posed images looks like to the rest of the project."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Protocol

import numpy as np
from PIL import ExifTags, Image, ImageOps

from tf_lab.errors import TFLabError
from tf_lab.support.arrays import read_array

MAX_PIXELS = 100_000_000  # of an image
MAX_METRES = 50.0  # rooms are smaller, in the median of a picture


class Capture(Protocol):
    """A posed sequence: cameras in memory, images read on demand.

    Attributes:
        name: a short name of the scene.
        size: (width, height) of the colour images, pixels.
        frames: the frames' names, in temporal order.
        K: float64 [N, 3, 3] intrinsics of the colour images (OpenCV pixels, see `geometry`).
        world_T_cam: float64 [N, 4, 4] in a z-up, metric world. Valid (finite, rigid) for every
            frame: frames without a usable pose are left out and listed in ``skipped``.
        source_T_world: float64 [4, 4] from this world back to the source's: a rotation, with the
            source's units per metre, and the way to the origin of a world far from its cameras.
        skipped: "frame: reason" of every frame left out.
    """

    name: str
    size: tuple[int, int]
    frames: list[str]
    K: np.ndarray
    world_T_cam: np.ndarray
    source_T_world: np.ndarray
    skipped: list[str]

    def image(self, index: int) -> np.ndarray:
        """uint8 [H, W, 3] RGB. Raises TFLabError, naming the file, if it can't be read."""
        ...

    def depth(self, index: int) -> np.ndarray | None:
        """float32 [H, W] camera z in metres, 0 where unknown; None if the source has none."""
        ...


class Altered:
    """A `Capture` as another, but for what its kind changes."""

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self.name, self.size, self.frames = capture.name, capture.size, capture.frames
        self.K, self.world_T_cam = capture.K, capture.world_T_cam
        self.source_T_world, self.skipped = capture.source_T_world, capture.skipped

    def image(self, index: int) -> np.ndarray:
        """uint8 [H, W, 3] RGB."""
        return self._capture.image(index)

    def depth(self, index: int) -> np.ndarray | None:
        """float32 [H, W] metres, 0 where unknown; None without depth."""
        return self._capture.depth(index)


def read_image(path: Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """An image file as uint8 [H, W, 3] RGB.

    Args:
        path: the file.
        size: (width, height) of what it shall be. A JPEG of another size is turned as its EXIF
            data asks for, if it then has this one.

    Raises:
        TFLabError: the file is missing, truncated or not an image.
    """
    return _decode(path, path, lambda image: _turned(image, size))


def decode_image(
    source: Path | IO[bytes], name: object, size: tuple[int, int] | None = None
) -> np.ndarray:
    """An encoded image (a file or a stream) as uint8 [H, W, 3] RGB.

    Args:
        source: where it is.
        name: how messages call it.
        size: the (width, height) it must have, checked before anything is decoded.

    Raises:
        TFLabError: it is missing, truncated, not an image, or of another size.
    """

    def check(image: Image.Image) -> Image.Image:
        if size is not None and image.size != size:
            raise ValueError(f"it is {image.width}x{image.height}, not {size[0]}x{size[1]}")
        return image

    return _decode(source, name, check)


@contextmanager
def open_image(source: Path | IO[bytes]) -> Iterator[Image.Image]:
    """An image whose pixels are not read yet, and are not too many to read.

    Raises:
        Exception: it is none; damaged data makes Pillow raise nearly anything.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # our own bound is below
        with Image.open(source) as image:
            width, height = image.size
            if width * height > MAX_PIXELS:
                gigabytes = width * height * 3 / 2**30
                raise ValueError(
                    f"{width}x{height} pixels, {gigabytes:.1f} GiB; at most {MAX_PIXELS / 1e6:.0f} "
                    "million are read"
                )
            yield image


def _decode(
    source: Path | IO[bytes], name: object, prepare: Callable[[Image.Image], Image.Image]
) -> np.ndarray:
    try:
        with open_image(source) as opened:
            image = prepare(opened)
            if not image.mode.startswith("I"):
                return np.asarray(image.convert("RGB"))
            grey = np.asarray(image).clip(0, 65535) >> 8  # 16 bits; convert would cut them off
            return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=-1)
    except Exception as error:  # damaged data makes Pillow raise nearly anything
        raise TFLabError(f"{name}: cannot be read as an image ({error})") from error


def _turned(image: Image.Image, size: tuple[int, int] | None) -> Image.Image:
    if size is None or image.size == size or upright_size(image) != size:
        return image
    return ImageOps.exif_transpose(image)


def upright_size(image: Image.Image) -> tuple[int, int]:
    """(width, height) of a picture after turning it as its EXIF data asks for (JPEG only)."""
    if image.format not in ("JPEG", "MPO"):
        return image.size
    try:
        lying = image.getexif().get(ExifTags.Base.Orientation) in (5, 6, 7, 8)
    except Exception:  # damaged data makes Pillow raise nearly anything
        lying = False
    return image.size[::-1] if lying else image.size


def read_depth(path: Path, scale: float | None = None) -> np.ndarray:
    """A depth map as float32 [H, W] metres, 0 where there is no reading.

    Args:
        path: a one-channel PNG, TIFF or ``.npy``. 0, 65535, NaN, infinity and negative values mean
            "no reading".
        scale: units per metre; None: 16-bit values are millimetres, floating-point ones metres.

    Raises:
        TFLabError: the file is missing, truncated or not a one-channel image, or its unit is
            unknown.
    """
    raw = _raw_depth(path)
    return metres(raw, _usual_scale(raw, path) if scale is None else scale)


def usual_depth_scale(path: Path) -> float:
    """Units per metre that `read_depth` takes where none is given. Raises TFLabError as it does."""
    return _usual_scale(_raw_depth(path), path)


def _raw_depth(path: Path) -> np.ndarray:
    try:
        if path.suffix.lower() == ".npy":
            raw = read_array(path, "write it again")
        else:
            with open_image(path) as image:
                raw = np.asarray(image)
                # 16 bits, which Pillow gives as more: of PGM, and in older versions of PNG
                if image.format in ("PNG", "PPM") and raw.dtype.itemsize > 2:
                    raw = raw.astype(np.uint16)
    except TFLabError:
        raise
    except Exception as error:  # damaged data makes Pillow raise nearly anything
        raise TFLabError(f"{path}: cannot be read as a depth image ({error})") from error
    if raw.ndim == 3 and 1 in (raw.shape[0], raw.shape[2]):
        raw = raw.squeeze(axis=0 if raw.shape[0] == 1 else 2)
    if raw.ndim != 2:
        channels = raw.shape[-1] if raw.ndim == 3 else raw.ndim
        raise TFLabError(f"{path}: a depth image has one channel, this one has {channels}")
    if raw.dtype.kind not in "uifb":
        raise TFLabError(f"{path}: {raw.dtype} values are no depth; store float32 metres")
    return raw


def _usual_scale(raw: np.ndarray, path: Path) -> float:
    """Units per metre of depth [H, W] of unstated unit. Raises TFLabError: nobody knows."""
    cure = "give depth_scale=UNITS_PER_METRE"
    if raw.dtype.itemsize == 1:
        raise TFLabError(f"{path}: 8-bit depth has no usual unit (16-bit: millimetres); {cure}")
    if raw.dtype.kind != "f":
        return 1000.0
    known = raw[np.isfinite(raw) & (raw > 0)]
    middle = np.median(known) if len(known) else 0.0
    if middle > MAX_METRES:
        raise TFLabError(
            f"{path}: floating-point depth is taken as metres, but this is {middle:.0f} in the "
            f"median; {cure}, 1000 for millimetres"
        )
    return 1.0


def metres(raw: np.ndarray, scale: float) -> np.ndarray:
    """Depth [H, W] of ``scale`` units a metre as float32 metres; see `read_depth`."""
    known = np.isfinite(raw) & (raw > 0)
    if raw.dtype.kind != "f" and raw.dtype.itemsize == 2:
        known &= raw < 65535
    return (np.where(known, raw, 0) / scale).astype(np.float32)
