"""A scan of 3D Scanner App (iPhone and iPad), exported as "all data".

::

    frame_00000.jpg         a picture; of most frames there is none, and they are not used
    frame_00000.json        "intrinsics": 9 numbers, row by row, pixels;
                            "cameraPoseARFrame": 16 numbers, row by row, camera to world, metres
    depth_00000.png         16-bit millimetres, of a LiDAR scan (optional)
    conf_00000.png          0 low, 1 medium, 2 high (optional)

The pictures are as the sensor has them (lying); cameras and world are ARKit's (see `apps`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tf_lab.data.lens import Camera
from tf_lab.data.readers.apps import DOWN, arkit_camera, confident_depth
from tf_lab.data.readers.fields import numbers, read_document
from tf_lab.data.readers.images import image_files, image_size
from tf_lab.data.readers.parsing import opencv_of_opengl
from tf_lab.data.readers.source import ColorFile, SourceCapture, SourceFrame, collect
from tf_lab.data.reading import Convention
from tf_lab.errors import TFLabError

NAME = "scanner_app"
LAYOUT = "frame_XXXXX.jpg, frame_XXXXX.json"
CONVENTION = Convention(axes="opengl")
PREFIX = "frame_"


def detect(directory: Path) -> bool:
    """Whether there is a picture with its json."""
    files = directory.glob(f"{PREFIX}*.json")
    return any(any(file.with_suffix(s).is_file() for s in (".jpg", ".png")) for file in files)


def read(directory: Path) -> SourceCapture:
    """The scan in ARKit's world.

    Raises:
        TFLabError: there is no picture, or no frame is usable.
    """
    colors = [path for path in image_files(directory) if path.name.startswith(PREFIX)]
    if not colors:
        raise TFLabError(f"{directory}: no picture {PREFIX}XXXXX.jpg in it; export all data")
    size = image_size(colors)
    frames, skipped = [], []
    for color in colors:
        try:
            camera, pose = _frame(color.with_suffix(".json"), size)
        except (ValueError, TFLabError) as error:
            skipped.append(f"{color.stem}: {error}")
            continue
        number = color.stem.removeprefix(PREFIX)
        depth = confident_depth(directory / f"depth_{number}.png", directory / f"conf_{number}.png")
        frames.append(SourceFrame(color.stem, camera, pose, ColorFile(color), depth))
    return collect(directory, frames, skipped, DOWN, convention=CONVENTION)


def _frame(file: Path, size: tuple[int, int]) -> tuple[Camera, np.ndarray]:
    """The camera and world_T_cam [4, 4]."""
    document = read_document(file, "the app writes intrinsics and cameraPoseARFrame there")
    fx, _, cx, _, fy, cy, *_ = numbers(document, "intrinsics", 9).tolist()
    pose = numbers(document, "cameraPoseARFrame", 16).reshape(4, 4)
    return arkit_camera(size, fx, fy, cx, cy), opencv_of_opengl(pose)
