"""Texts of the sources: poses, intrinsics and lists of timestamps."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tf_lab.data.lens import Camera, camera_of
from tf_lab.data.readers.images import image_size
from tf_lab.errors import TFLabError
from tf_lab.support.text import parse_numbers, read_lines, read_numbers, read_text

MAX_GAP = 0.02  # seconds between an image and its pose: under a frame at 30 Hz
K_CURE = "it holds the 3x3 intrinsics of the colour images in pixels: fx 0 cx / 0 fy cy / 0 0 1"
HOW_TO_POSES = (  # where images or a video have none
    "find them by COLMAP or nerfstudio, or film with an app that records them (docs/own_video.md "
    "says how); poses of your own go into poses.txt (a camera-to-world matrix a line) and K.txt "
    "beside the video or images/ (docs/data.md)"
)
ROUNDING = 1e-6  # seconds; timestamps are written with six decimals


def parse_pose(text: str) -> np.ndarray:
    """A pose [4, 4] from 16 numbers, or from the 12 of its upper three rows, row by row.

    NaN and infinity are numbers here: sources mark lost frames with them.

    Raises:
        ValueError: it is something else; the message says what.
    """
    values = parse_numbers(text)
    if len(values) not in (12, 16):
        raise ValueError(f"{len(values)} values, a pose has 16 (4x4) or 12 (3x4)")
    pose = np.eye(4)
    pose.flat[: len(values)] = values
    return pose


def read_pose(path: Path, cure: str) -> np.ndarray:
    """A text file with one pose [4, 4] (see `parse_pose`), in lines as it likes.

    Raises:
        TFLabError: the file is missing, or holds something else.
    """
    try:
        return parse_pose(read_text(path, cure))
    except ValueError as error:
        raise TFLabError(f"{path}: {error}; {cure}") from error


def read_poses(path: Path, cure: str) -> list[np.ndarray]:
    """A text file with one pose [4, 4] a line (see `parse_pose`).

    Raises:
        TFLabError: the file is missing, or a line is no pose.
    """
    poses = []
    for number, line in read_lines(path, cure):
        try:
            poses.append(parse_pose(line))
        except ValueError as error:
            raise TFLabError(f"{path}, line {number}: {error}; write one pose a line") from error
    return poses


def pose_of_quaternion(
    quaternion_wxyz: Sequence[float], translation: Sequence[float]
) -> np.ndarray:
    """A rigid transform [4, 4] from a quaternion (w, x, y, z) of any length and a translation.

    Raises:
        ValueError: the quaternion has no length, or a number is NaN or infinite.
    """
    numbers = np.array([*quaternion_wxyz, *translation], np.float64)
    if not np.isfinite(numbers).all():
        raise ValueError("NaN or infinity in the pose (frame lost)")
    w, x, y, z = numbers[:4] / (np.abs(numbers[:4]).max() or 1.0)  # squares of any size are finite
    if math.hypot(w, x, y, z) == 0:
        raise ValueError("a quaternion of zeros is no rotation")
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    pose[:3, 3] = numbers[4:]
    return pose


def opencv_of_opengl(world_T_cam: np.ndarray) -> np.ndarray:
    """A pose [4, 4] of a camera with x right, y up, z back, for one with x right, y down, z front.

    The camera stays where it is; ARKit, Blender, NeRF and nerfstudio have OpenGL's axes.
    """
    return world_T_cam @ np.diag([1.0, -1.0, -1.0, 1.0])


def read_intrinsics(path: Path, size: tuple[int, int]) -> Camera:
    """A text file of 3x3 numbers as the camera of images of (width, height) ``size``.

    Raises:
        TFLabError: the file is missing, or this is not the K of such images.
    """
    return _camera(path, _read_K(path), size)


def read_camera(path: Path, images: Sequence[Path]) -> Camera:
    """A text file of 3x3 numbers as the camera of image files, of the size that it fits.

    Raises:
        TFLabError: the file is missing, or this is not the K of such images.
    """
    K = _read_K(path)
    return _camera(path, K, image_size(images, (K[0, 2], K[1, 2])))


def _read_K(path: Path) -> np.ndarray:
    values = read_numbers(path, K_CURE)
    if len(values) != 9:
        raise TFLabError(f"{path}: {len(values)} values instead of 9; {K_CURE}")
    return np.array(values).reshape(3, 3)


def _camera(path: Path, K: np.ndarray, size: tuple[int, int]) -> Camera:
    try:
        return camera_of(K, size)
    except TFLabError as error:
        raise TFLabError(f"{path}: {error}; {K_CURE}") from error


@dataclass(frozen=True)
class Timeline:
    """The lines of a list by ascending time: seconds, and the words after them."""

    times: list[float]
    values: list[list[str]]

    def nearest(self, time: float) -> list[str] | None:
        """The words of the line nearest in time; None: it is farther than `MAX_GAP`."""
        i = bisect_left(self.times, time)
        around = range(max(0, i - 1), min(i + 1, len(self.times)))
        gap, best = min(((abs(self.times[k] - time), k) for k in around), default=(math.inf, 0))
        return self.values[best] if gap <= MAX_GAP + ROUNDING else None


def read_timeline(path: Path, columns: str, separator: str | None = None) -> Timeline:
    """The lines "timestamp COLUMNS" of a file, by ascending time; # starts a comment.

    Args:
        path: the file.
        columns: names of the columns after the timestamp (seconds), for their number and the
            message.
        separator: between the columns; None: blanks.

    Raises:
        TFLabError: it is missing, or has other lines.
    """
    cure = f"a line holds: {(separator or ' ').join(['timestamp', *columns.split()])}"
    count = len(columns.split())
    rows = []
    for number, line in read_lines(path, cure):
        words = line.split(separator, maxsplit=count)
        try:
            time = float(words[0])
        except ValueError:
            time = math.nan
        if len(words) != count + 1 or not math.isfinite(time):
            raise TFLabError(f"{path}, line {number}: {line[:60]!r}; {cure}")
        rows.append((time, [word.strip() for word in words[1:]]))
    rows.sort(key=lambda row: row[0])
    return Timeline([time for time, _ in rows], [words for _, words in rows])
