"""A 7-Scenes sequence: one folder of numbered colour, depth and pose files.

::

    frame-000000.color.png      or .jpg
    frame-000000.depth.png      16-bit millimetres, 0 and 65535 = no reading (optional)
    frame-000000.pose.txt       4x4, camera to world
    camera-intrinsics.txt       3x3 (not part of the published sequences)

The published sequences (Shotton et al., CVPR 2013) come from two cameras of a Kinect, 640x480 each,
that are not registered: the poses are the depth camera's, of focal length 585; the colour camera
has about 525 (`COLOR`, `DEPTH`, `COLOR_T_DEPTH`, which photo-consistency of the sequences bears
out). They are so read where there is no ``camera-intrinsics.txt``, or where it states just the
depth camera's published numbers for 640x480 images, as the copies with TSDF fusion programs do.
Any other such file is taken at its word for both: the colour images' K, the depth registered to
them, the poses those of that one camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tf_lab.data.lens import Camera
from tf_lab.data.readers.images import image_files, image_size
from tf_lab.data.readers.parsing import HOW_TO_POSES, read_camera, read_pose
from tf_lab.data.readers.source import ColorFile, DepthFile, Rig, SourceCapture, collect
from tf_lab.errors import TFLabError
from tf_lab.support.words import counted

CURE = "it holds the 4x4 pose, camera to world"
NAME = "seven_scenes"
LAYOUT = "frame-XXXXXX.color.(jpg|png), frame-XXXXXX.pose.txt"
DEPTH = Camera((640, 480), 585.0, 585.0, 320.0, 240.0)  # Shotton et al. 2013
COLOR = Camera((640, 480), 525.0, 525.0, 320.0, 240.0)
COLOR_T_DEPTH = np.eye(4)
COLOR_T_DEPTH[0, 3] = -0.025  # metres: the colour camera is to the right of the depth camera
PUBLISHED = Rig(COLOR, DEPTH, COLOR_T_DEPTH)


def detect(directory: Path) -> bool:
    """Whether the directory holds a frame's colour image, and is not of `sensreader`."""
    return not (directory / "_info.txt").is_file() and any(directory.glob("frame-*.color.*"))


def read(directory: Path) -> SourceCapture:
    """The sequence in its own world frame. A frame without a readable pose file is skipped.

    Raises:
        TFLabError: no poses, no usable frame, or no good intrinsics.
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
    posed = sorted(path.name.split(".")[0] for path in directory.glob("frame-*.pose.txt"))
    if not posed:
        raise TFLabError(
            f"{directory}: {counted(len(colors), 'image')}, but no camera poses "
            f"(frame-XXXXXX.pose.txt); {HOW_TO_POSES}"
        )
    rig = _rig(directory / "camera-intrinsics.txt", list(colors.values()))
    skipped = [f"{name}: no colour image" for name in posed if name not in colors]
    frames = []
    for name, color in colors.items():
        try:
            pose = read_pose(directory / f"{name}.pose.txt", CURE)
        except TFLabError as error:
            skipped.append(f"{name}: {error}")
            continue
        path = directory / f"{name}.depth.png"
        depth = DepthFile(path) if path.exists() else None
        frames.append(rig.frame(name, pose, ColorFile(color), depth))
    return collect(directory, frames, skipped)


def _rig(intrinsics: Path, images: Sequence[Path]) -> Rig:
    """The cameras of the sequence with these colour images."""
    if not intrinsics.exists() and image_size(images) == COLOR.size:
        return PUBLISHED
    camera = read_camera(intrinsics, images)
    return PUBLISHED if camera == DEPTH else Rig(camera)
