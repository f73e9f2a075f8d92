"""A recording of the app Stray Scanner (iPhone and iPad with LiDAR).

::

    rgb.mp4                 the camera's images as the sensor has them (lying)
    camera_matrix.csv       3x3 of these images, pixels
    odometry.csv            "timestamp, frame, x, y, z, qx, qy, qz, qw" a line, under a line of
                            these names: camera to world, metres; newer versions add "fx, fy, cx,
                            cy" of the frame, which go before camera_matrix.csv: phones refocus
    depth/000000.png        or .npy, by the number of the frame: millimetres (optional)
    confidence/000000.png   0 low, 1 medium, 2 high (optional)

The app turns ARKit's camera axes into x right, y down, z forward; the world is ARKit's (see
`apps`), and so is the principal point.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from tf_lab.data.lens import Camera
from tf_lab.data.readers.apps import DOWN, arkit_camera, confident_depth
from tf_lab.data.readers.frames_of_video import Video, VideoFrame
from tf_lab.data.readers.parsing import pose_of_quaternion, read_intrinsics
from tf_lab.data.readers.source import Pixels, SourceCapture, SourceFrame, collect
from tf_lab.data.reading import Convention
from tf_lab.errors import TFLabError
from tf_lab.support.text import read_lines

NAME = "stray_scanner"
LAYOUT = "odometry.csv, camera_matrix.csv, rgb.mp4"
CONVENTION = Convention(quaternions="xyzw")
COLUMNS = ("frame", "x", "y", "z", "qx", "qy", "qz", "qw")
INTRINSICS = ("fx", "fy", "cx", "cy")
MAX_FRAME = 10**7


def detect(directory: Path) -> bool:
    """Whether the poses and the camera are there."""
    return all((directory / name).is_file() for name in ("odometry.csv", "camera_matrix.csv"))


def read(directory: Path) -> SourceCapture:
    """The recording in ARKit's world.

    Raises:
        TFLabError: a part is missing or damaged, or no frame is usable.
    """
    video = Video(directory / "rgb.mp4", upright=False)
    file = directory / "camera_matrix.csv"
    given = read_intrinsics(file, video.size)
    try:
        camera = arkit_camera(video.size, given.fx, given.fy, given.cx, given.cy)
    except ValueError as error:
        raise TFLabError(f"{file}: {error}") from error
    found, skipped = _odometry(directory / "odometry.csv", video.size)
    count = video.count(1 + max(found, default=-1))
    skipped += [f"{index:06d}: not one of the {count} images" for index in found if index >= count]
    frames = [
        SourceFrame(
            f"{index:06d}", own or camera, pose, VideoFrame(video, index), _depth(directory, index)
        )
        for index, (pose, own) in sorted(found.items())
        if index < count
    ]
    return collect(directory, frames, skipped, DOWN, convention=CONVENTION)


def _odometry(
    file: Path, size: tuple[int, int]
) -> tuple[dict[int, tuple[np.ndarray, Camera | None]], list[str]]:
    """world_T_cam [4, 4] and camera by the number of the frame, and what is wrong with other lines.

    The camera is None where the file has no intrinsics of frames.
    """
    cure = f"its first line names the columns: timestamp, {', '.join(COLUMNS)}"
    lines = read_lines(file, cure)
    rows = list(
        csv.reader((line for _, line in lines), skipinitialspace=True, quoting=csv.QUOTE_NONE)
    )
    names = [name.strip() for name in rows[0]] if rows else []
    if missing := [name for name in COLUMNS if name not in names]:
        raise TFLabError(f"{file}: no column {missing[0]}; {cure}")
    own = all(name in names for name in INTRINSICS)
    found, skipped = {}, []
    for (number, line), row in zip(lines[1:], rows[1:], strict=False):
        try:
            values = dict(zip(names, row, strict=False))
            frame, x, y, z, qx, qy, qz, qw = (float(values[name]) for name in COLUMNS)
            if not 0 <= frame < MAX_FRAME:
                raise ValueError(f"{values['frame'][:20]!r} is no number of a frame")
            pose, camera = pose_of_quaternion((qw, qx, qy, qz), (x, y, z)), None
            if own:
                camera = arkit_camera(size, *(float(values[name]) for name in INTRINSICS))
            found[int(frame)] = pose, camera
        except (KeyError, ValueError, TFLabError) as error:
            skipped.append(f"line {number}, {line[:30]!r}: {error}")
    return found, skipped


def _depth(directory: Path, index: int) -> Pixels | None:
    confidence = directory / "confidence" / f"{index:06d}.png"
    files = (directory / "depth" / f"{index:06d}{suffix}" for suffix in (".png", ".npy"))
    depths = (confident_depth(file, confidence) for file in files)
    return next((depth for depth in depths if depth is not None), None)
