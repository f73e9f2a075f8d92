"""What every source of posed images looks like to the rest of the project."""

from __future__ import annotations

from pathlib import Path
from typing import IO, Protocol

import numpy as np
from PIL import Image

from tf_lab.errors import TFLabError


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
            source's units per metre.
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


def read_image(path: Path) -> np.ndarray:
    """An image file as uint8 [H, W, 3] RGB.

    Raises:
        TFLabError: the file is missing, truncated or not an image.
    """
    return decode_image(path, path)


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
    try:
        with Image.open(source) as image:
            if size is not None and image.size != size:
                raise ValueError(f"it is {image.width}x{image.height}, not {size[0]}x{size[1]}")
            return np.asarray(image.convert("RGB"))
    except Exception as error:  # damaged data makes Pillow raise nearly anything
        raise TFLabError(f"{name}: cannot be read as an image ({error})") from error


def read_depth(path: Path, scale: float = 1000.0) -> np.ndarray:
    """A 16-bit depth PNG as float32 [H, W] metres; 0 and 65535 mean "no reading" and give 0.

    Args:
        path: the file.
        scale: units per metre (1000: millimetres).

    Raises:
        TFLabError: the file is missing, truncated or not a one-channel image.
    """
    try:
        with Image.open(path) as image:
            raw = np.asarray(image)
    except Exception as error:  # damaged data makes Pillow raise nearly anything
        raise TFLabError(f"{path}: cannot be read as a depth image ({error})") from error
    if raw.ndim != 2:
        raise TFLabError(f"{path}: a depth image has one channel, this one has {raw.shape[-1]}")
    return metres(raw, scale)


def metres(raw: np.ndarray, scale: float) -> np.ndarray:
    """16-bit depth [H, W] of ``scale`` units a metre as float32 metres; see `read_depth`."""
    return (np.where(raw >= 65535, 0, raw) / scale).astype(np.float32)
