"""A 7-Scenes sequence: one folder of numbered colour, depth and pose files.

::

    camera-intrinsics.txt       3x3, of the colour images (to which the depth is registered); not
                                part of the published sequences: the default depth intrinsics of
                                their page (585, 320, 240) then serve both cameras, which are not
                                registered there
    frame-000000.color.jpg      or .png
    frame-000000.depth.png      16-bit millimetres, 0 and 65535 = no reading (optional)
    frame-000000.pose.txt       4x4, camera to world
"""

from __future__ import annotations

from pathlib import Path

from tf_lab.data.lens import Camera
from tf_lab.data.readers.images import image_files, image_size
from tf_lab.data.readers.parsing import parse_pose, read_intrinsics
from tf_lab.data.readers.source import ColorFile, DepthFile, SourceCapture, SourceFrame, collect
from tf_lab.errors import TFLabError

NAME = "seven_scenes"
LAYOUT = "frame-XXXXXX.color.(jpg|png), frame-XXXXXX.pose.txt"
PUBLISHED = Camera((640, 480), 585.0, 585.0, 320.0, 240.0)  # Shotton et al. 2013


def detect(directory: Path) -> bool:
    """Whether the directory holds a frame's colour image."""
    return any(directory.glob("frame-*.color.*"))


def read(directory: Path) -> SourceCapture:
    """The sequence in its own world frame. A frame without a readable pose file is skipped.

    Raises:
        TFLabError: no usable frame, or no good intrinsics.
    """
    colors = {
        path.name.split(".")[0]: path
        for path in image_files(directory)
        if path.name.startswith("frame-") and path.stem.endswith(".color")
    }
    if not colors:
        raise TFLabError(
            f"{directory}: no frame-XXXXXX.color.jpg or .png in it; give the folder "
            "that holds the frames themselves"
        )
    size = image_size(colors.values())
    intrinsics = directory / "camera-intrinsics.txt"
    published = size == PUBLISHED.size and not intrinsics.exists()
    camera = PUBLISHED if published else read_intrinsics(intrinsics, size)
    posed = sorted(path.name.split(".")[0] for path in directory.glob("frame-*.pose.txt"))
    skipped = [f"{name}: no colour image" for name in posed if name not in colors]
    frames = []
    for name, color in colors.items():
        try:
            pose = parse_pose((directory / f"{name}.pose.txt").read_text())
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            skipped.append(f"{name}: no pose in {name}.pose.txt ({reason})")
            continue
        depth = directory / f"{name}.depth.png"
        frames.append(
            SourceFrame(
                name, camera, pose, ColorFile(color), DepthFile(depth) if depth.exists() else None
            )
        )
    return collect(directory, frames, skipped)
