"""A video of the app Record3D (iPhone and iPad), exported as EXR + RGB, or an unzipped .r3d file.

::

    metadata.json           or metadata: "K": 9 numbers, column by column, pixels of "w" x "h";
                            "perFrameIntrinsicCoeffs": [fx, fy, cx, cy] a frame (goes first);
                            "poses": [qx, qy, qz, qw, tx, ty, tz] a frame, camera to world, metres
    rgb/0.jpg, depth/0.*    or rgbd/0.jpg, rgbd/0.*: by the number of the frame

Camera axes are OpenGL's, of the upright images that the app makes, and the principal point is from
their corner. The world is that of the first camera: nothing says where down is. Depth is read from
.npy and TIFF (metres), 16-bit PNG (millimetres), and .depth or .bin of bare float32 metres, "dw" x
"dh". The app itself writes .exr, and compresses .depth with LZFSE; for these there is no reader at
hand: such depth is left out, and the log says so.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tf_lab.data.capture import metres
from tf_lab.data.lens import Camera
from tf_lab.data.readers.apps import arkit_camera
from tf_lab.data.readers.fields import number, numbers, read_document
from tf_lab.data.readers.images import at_file_size, image_files
from tf_lab.data.readers.parsing import opencv_of_opengl, pose_of_quaternion
from tf_lab.data.readers.source import (
    ColorFile,
    DepthFile,
    Pixels,
    SourceCapture,
    SourceFrame,
    collect,
)
from tf_lab.data.reading import Convention
from tf_lab.errors import TFLabError

NAME = "record3d"
LAYOUT = "metadata.json, rgb/ (or metadata, rgbd/)"
CONVENTION = Convention(axes="opengl", quaternions="xyzw")
CURE = "Record3D writes K, w, h and poses there"
FOLDERS = (("rgb", "depth"), ("rgbd", "rgbd"))
IMAGES, BARE = (".npy", ".tif", ".tiff", ".png"), (".depth", ".bin")

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class BareDepth:
    """float32 [H, W] metres of a file that holds just these, of (width, height) ``size``."""

    path: Path
    size: tuple[int, int]

    def __call__(self) -> np.ndarray:
        """Read it."""
        try:
            values = np.frombuffer(self.path.read_bytes(), "<f4")
            return metres(values.reshape(self.size[::-1]), 1.0)
        except (OSError, ValueError) as error:
            raise TFLabError(f"{self.path}: cannot be read as depth ({error})") from error

    def __str__(self) -> str:
        return str(self.path)


def detect(directory: Path) -> bool:
    """Whether images and metadata lie where the app has them."""
    return _metadata(directory).is_file() and _folders(directory)[0].is_dir()


def read(directory: Path) -> SourceCapture:
    """The video in the world of its first camera.

    Raises:
        TFLabError: a part is missing or damaged, or no frame is usable.
    """
    file, (colors, depths) = _metadata(directory), _folders(directory)
    document = read_document(file, CURE)
    found, skipped = [], []
    images = image_files(colors) if colors.is_dir() else []
    pictures = {file.stem for file in images if file.suffix.lower() != ".png"}
    for color in images:
        is_depth = colors == depths and color.suffix.lower() == ".png" and color.stem in pictures
        if not color.stem.isdecimal() or is_depth:
            continue
        try:
            found.append((color, *_frame(document, int(color.stem))))
        except (ValueError, TFLabError) as error:
            skipped.append(f"{color.stem[:40]}: {error}")
    cameras = at_file_size([camera for _, camera, _ in found], [color for color, _, _ in found])
    frames = [
        SourceFrame(
            color.stem,
            camera,
            pose,
            ColorFile(color),
            _depth(document, depths, color),
            stated=stated,
        )
        for (color, stated, pose), camera in zip(found, cameras, strict=True)
    ]
    files = sorted(depths.iterdir()) if depths.is_dir() else []
    compressed = [file for file in files if file.suffix in (".exr", *BARE)]
    if compressed and all(frame.depth is None for frame in frames):
        logger.warning("%s: its depth is left out, for files like %s cannot be read; convert them "
                       "to .npy or TIFF, float32 metres", depths, compressed[0].name)  # fmt: skip
    return collect(directory, frames, skipped, convention=CONVENTION)


def _metadata(directory: Path) -> Path:
    file = directory / "metadata"
    return file if file.is_file() else directory / "metadata.json"


def _folders(directory: Path) -> tuple[Path, Path]:
    """Where colour and depth are."""
    pairs = [(directory / color, directory / depth) for color, depth in FOLDERS]
    return next((pair for pair in pairs if pair[0].is_dir()), pairs[0])


def _frame(document: dict[str, Any], index: int) -> tuple[Camera, np.ndarray]:
    """The camera and world_T_cam [4, 4] of a frame. Raises ValueError or TFLabError."""
    size = (round(number(document, "w")), round(number(document, "h")))
    if document.get("perFrameIntrinsicCoeffs"):
        fx, fy, cx, cy, *_ = _of_frame(document, "perFrameIntrinsicCoeffs", index, 4)
    else:
        fx, _, _, _, fy, _, cx, cy, _ = numbers(document, "K", 9).tolist()
    qx, qy, qz, qw, *position = _of_frame(document, "poses", index, 7)
    pose = opencv_of_opengl(pose_of_quaternion((qw, qx, qy, qz), position))
    return arkit_camera(size, fx, fy, cx, cy), pose


def _of_frame(document: dict[str, Any], key: str, index: int, count: int) -> list[float]:
    """What a list of the document says of a frame: so many numbers."""
    values = document.get(key)
    if not isinstance(values, list) or index >= len(values):
        raise ValueError(f"{key} has nothing on it")
    return numbers({key: values[index]}, key, count).tolist()


def _depth(document: dict[str, Any], folder: Path, color: Path) -> Pixels | None:
    """Where the depth map of an image is, if it can be read."""
    for suffix in IMAGES:
        file = folder / f"{color.stem}{suffix}"
        if file != color and file.is_file():
            return DepthFile(file)
    try:
        size = (round(number(document, "dw")), round(number(document, "dh")))
    except ValueError:
        return None
    bare = (folder / f"{color.stem}{suffix}" for suffix in BARE)
    fitting = (f for f in bare if f.is_file() and f.stat().st_size == 4 * size[0] * size[1] > 0)
    return next((BareDepth(file, size) for file in fitting), None)
