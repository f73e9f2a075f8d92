"""A sequence of the TUM RGB-D benchmark, or of anyone who writes its layout.

::

    rgb.txt                     "timestamp rgb/FILE.png" a line, seconds
    groundtruth.txt             "timestamp tx ty tz qx qy qz qw" a line, camera to world, metres
    depth.txt                   "timestamp depth/FILE.png" a line (optional): 16-bit, 5000 units a
                                metre, 0 = no reading, registered to the colour image
    associations.txt            instead of rgb.txt and depth.txt: "timestamp FILE timestamp FILE" a
                                line, colour and depth in either order (the path tells)
    camera-intrinsics.txt       3x3, of undistorted images; or K.txt. Without them the published
                                calibration of the freiburg1, 2 or 3 in the folder's name

Lines that start with # are comments. A colour image gets the depth map and the pose of the nearest
timestamps, at most 0.02 s away as in the benchmark's own tool; without a pose it is skipped,
without depth it stays. The three cameras differ in their colour intrinsics, not in the scale of
depth: the depth images were published with each sensor's own correction (1.035, 1.031, 1.000)
applied. The world is that of the motion capture, its z axis points up.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from tf_lab.data.lens import Camera
from tf_lab.data.readers.images import image_size, is_file
from tf_lab.data.readers.parsing import (
    MAX_GAP,
    Timeline,
    pose_of_quaternion,
    read_intrinsics,
    read_timeline,
)
from tf_lab.data.readers.source import ColorFile, DepthFile, SourceCapture, SourceFrame, collect
from tf_lab.data.reading import Convention
from tf_lab.errors import TFLabError

NAME = "tum"
LAYOUT = "rgb.txt or associations.txt, groundtruth.txt"
ASSOCIATIONS = "associations.txt"
CONVENTION = Convention(quaternions="xyzw")
DOWN = (0.0, 0.0, -1.0)
DEPTH_SCALE = 5000.0  # units a metre
MOST_SECONDS = 1e11  # a clock that counts from 1970 is below it
INTRINSICS = ("camera-intrinsics.txt", "K.txt")

_SIZE = (640, 480)
_CALIBRATIONS = {  # of the colour cameras, as published; freiburg3's images are undistorted
    "freiburg1": Camera(
        _SIZE, 517.306408, 516.469215, 318.643040, 255.313989,
        (0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
    ),
    "freiburg2": Camera(
        _SIZE, 520.908620, 521.007327, 325.141442, 249.701764,
        (0.231222, -0.784899, -0.003257, -0.000105, 0.917205),
    ),
    "freiburg3": Camera(_SIZE, 535.4, 539.2, 320.1, 247.6),
}  # fmt: skip


def detect(directory: Path) -> bool:
    """Whether the lists of images and poses are there."""
    images = any((directory / name).is_file() for name in ("rgb.txt", ASSOCIATIONS))
    return images and (directory / "groundtruth.txt").is_file()


def read(directory: Path) -> SourceCapture:
    """The sequence in the world frame of its motion capture.

    Raises:
        TFLabError: a list is missing or damaged, no frame is usable, or the camera is unknown.
    """
    poses = read_timeline(directory / "groundtruth.txt", "tx ty tz qx qy qz qw")
    kept: dict[str, tuple[Path, np.ndarray, DepthFile | None]] = {}
    skipped = []
    for time, file, depth in _images(directory):
        color = _file(directory, file)
        try:
            if color.stem in kept:
                raise ValueError("a second image of that name")
            if not is_file(color):
                raise ValueError(f"{color}: no such image")
            pose = _pose(poses.nearest(time))
        except ValueError as error:
            skipped.append(f"{color.stem}: {error}")
            continue
        kept[color.stem] = color, pose, _depth(directory, depth)
    if not kept:
        if poses.times and poses.times[-1] > MOST_SECONDS:
            raise TFLabError(
                f"{directory / 'groundtruth.txt'}: {poses.times[-1]:.0f} is no timestamp in "
                "seconds; divide those of all its lists, nanoseconds by 1e9"
            )
        return collect(directory, [], skipped)
    camera = _camera(directory, image_size([color for color, _, _ in kept.values()]))
    frames = [
        SourceFrame(name, camera, pose, ColorFile(color), depth)
        for name, (color, pose, depth) in kept.items()
    ]
    return collect(directory, frames, skipped, DOWN, convention=CONVENTION)


def _images(directory: Path) -> Iterator[tuple[float, str, str | None]]:
    """The time, the colour image and the depth map of each frame, as the lists name them."""
    if not (directory / "rgb.txt").is_file() and (directory / ASSOCIATIONS).is_file():
        pairs = read_timeline(directory / ASSOCIATIONS, "file timestamp file")
        for time, (first, other_time, second) in zip(pairs.times, pairs.values, strict=True):
            second = second.split()[0]  # whatever follows, such as a pose
            if "depth" in first and "depth" not in second:
                yield _seconds(other_time, directory), second, first
            else:
                yield time, first, second
        return
    colors = read_timeline(directory / "rgb.txt", "file")
    listed = (directory / "depth.txt").exists()
    depths = read_timeline(directory / "depth.txt", "file") if listed else Timeline([], [])
    for time, (file,) in zip(colors.times, colors.values, strict=True):
        words = depths.nearest(time)
        yield time, file, None if words is None else words[0]


def _seconds(word: str, directory: Path) -> float:
    try:
        return float(word)
    except ValueError as error:
        raise TFLabError(f"{directory / ASSOCIATIONS}: {word[:40]!r} is no timestamp") from error


def _pose(words: Sequence[str] | None) -> np.ndarray:
    """The pose [4, 4] of a line. Raises ValueError: it is none, or not one."""
    if words is None:
        raise ValueError(f"no pose within {MAX_GAP} s")
    tx, ty, tz, qx, qy, qz, qw = (float(word) for word in words)
    return pose_of_quaternion((qw, qx, qy, qz), (tx, ty, tz))


def _depth(directory: Path, file: str | None) -> DepthFile | None:
    if file is None or not is_file(_file(directory, file)):
        return None
    return DepthFile(_file(directory, file), DEPTH_SCALE)


def _file(directory: Path, name: str) -> Path:
    return directory / name.replace("\\", "/")  # written on Windows


def _camera(directory: Path, size: tuple[int, int]) -> Camera:
    for name in INTRINSICS:
        if (directory / name).exists():
            return read_intrinsics(directory / name, size)
    cure = f"write {INTRINSICS[0]} with fx 0 cx / 0 fy cy / 0 0 1"
    names = f"{directory.name} {directory.resolve().name}"  # a link's, and of what it leads to
    known = re.search("|".join(_CALIBRATIONS), names)
    if known is None:
        raise TFLabError(
            f"{directory}: its camera is unknown: no {' or '.join(INTRINSICS)} in it, and no "
            f"{', '.join(_CALIBRATIONS)} in its name; {cure}"
        )
    camera = _CALIBRATIONS[known.group()]
    if camera.size != size:
        raise TFLabError(
            f"{directory}: its images are {size[0]}x{size[1]}, those of {known.group()} "
            f"{camera.size[0]}x{camera.size[1]}; {cure}"
        )
    return camera
