"""A capture of Polycam (iPhone and iPad with LiDAR), exported as raw data.

::

    keyframes/corrected_images/ID.jpg       without the lens' distortion, as the sensor has them
    keyframes/corrected_cameras/ID.json     "fx", "fy", "cx", "cy", "width", "height", pixels;
                                            "t_00" to "t_23": row, column of camera to world, metres
    keyframes/images/, keyframes/cameras/   the same as recorded, of captures too large to correct
    keyframes/depth/ID.png                  16-bit millimetres (optional)
    keyframes/confidence/ID.png             0 low, about 54 to 127 medium, 255 high (optional)

IDs are timestamps. Polycam has refined the corrected poses over the whole capture: they go first.
Cameras and world are ARKit's (see `apps`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tf_lab.data.lens import Camera
from tf_lab.data.readers.apps import DOWN, arkit_camera, confident_depth
from tf_lab.data.readers.fields import number, read_document
from tf_lab.data.readers.images import at_file_size, image_files
from tf_lab.data.readers.parsing import opencv_of_opengl
from tf_lab.data.readers.source import ColorFile, SourceCapture, SourceFrame, collect
from tf_lab.data.reading import Convention
from tf_lab.errors import TFLabError

NAME = "polycam"
LAYOUT = "keyframes/ with corrected_images/ and corrected_cameras/, or images/ and cameras/"
CONVENTION = Convention(axes="opengl")
KINDS = ("corrected_", "")


def detect(directory: Path) -> bool:
    """Whether there are pictures and cameras."""
    return _kind(directory / "keyframes") is not None


def read(directory: Path) -> SourceCapture:
    """The capture in ARKit's world.

    Raises:
        TFLabError: there is no picture, or no frame is usable.
    """
    folder = directory / "keyframes"
    kind = _kind(folder)
    if kind is None:
        raise TFLabError(f"{directory}: not the raw data of Polycam; looked for {LAYOUT}")
    found, skipped = [], []
    for color in image_files(folder / f"{kind}images"):
        try:
            found.append((color, *_frame(folder / f"{kind}cameras" / f"{color.stem}.json")))
        except (ValueError, TFLabError) as error:
            skipped.append(f"{color.stem}: {error}")
    cameras = at_file_size([camera for _, camera, _ in found], [color for color, _, _ in found])
    frames = []
    for (color, stated, pose), camera in zip(found, cameras, strict=True):
        depth = confident_depth(
            folder / "depth" / f"{color.stem}.png",
            folder / "confidence" / f"{color.stem}.png",
        )
        frames.append(SourceFrame(color.stem, camera, pose, ColorFile(color), depth, stated=stated))
    return collect(directory, frames, skipped, DOWN, convention=CONVENTION)


def _kind(folder: Path) -> str | None:
    """What the names of the best pictures and cameras begin with."""
    pairs = {kind: (folder / f"{kind}images", folder / f"{kind}cameras") for kind in KINDS}
    return next((kind for kind, pair in pairs.items() if all(f.is_dir() for f in pair)), None)


def _frame(file: Path) -> tuple[Camera, np.ndarray]:
    """The camera and world_T_cam [4, 4]."""
    document = read_document(file, "Polycam writes fx, fy, cx, cy and t_00 to t_23 there")
    width, height = (round(number(document, key)) for key in ("width", "height"))
    intrinsics = (number(document, key) for key in ("fx", "fy", "cx", "cy"))
    pose = np.eye(4)
    pose[:3] = [[number(document, f"t_{i}{j}") for j in range(4)] for i in range(3)]
    return arkit_camera((width, height), *intrinsics), opencv_of_opengl(pose)
