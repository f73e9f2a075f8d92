"""A ``transforms.json`` of nerfstudio, instant-ngp or the NeRF authors, with its images.

::

    {
      "fl_x": 535, "fl_y": 535, "cx": 320, "cy": 240, "w": 640, "h": 480,   pixels
      "camera_model": "OPENCV", "k1": 0, "k2": 0, "p1": 0, "p2": 0,         (optional)
      "frames": [{
        "file_path": "images/0001.png",         relative to the json; the suffix may be missing
        "depth_file_path": "depth/0001.png",    16-bit, camera z, 0 = no reading (optional)
        "transform_matrix": [[...], ...]        4x4, camera to world
      }]
    }

What is said of the camera may also be said of a single frame, which goes first. ``camera_angle_x``
(and ``_y``), the field of view in radians, may stand for the focal lengths; the principal point is
the middle of the image without cx, cy, and w, h are those of the images. Depth is in units of
``depth_unit_scale_factor`` metres, 0.001 without it.

Camera axes are OpenGL's: x right, y up, z back. cx, cy are measured from the corner of the image:
both programs put the centre of the first pixel at (0.5, 0.5) when they cast its ray, and take cx
from COLMAP, which does so too. The format has no unit of length (converters from COLMAP write any)
and no gravity: the poses are taken as metres.
"""

from __future__ import annotations

import json
import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tf_lab.data.lens import Camera
from tf_lab.data.readers.images import (
    at_file_size,
    frame_names,
    image_size,
    is_file,
    natural_order,
)
from tf_lab.data.readers.parsing import opencv_of_opengl, read_text
from tf_lab.data.readers.settings import Convention
from tf_lab.data.readers.source import ColorFile, DepthFile, SourceCapture, SourceFrame, collect
from tf_lab.errors import TFLabError

NAME = "transforms"
LAYOUT = "transforms.json"
CONVENTION = Convention(axes="opengl")
DEPTH_UNIT = 0.001  # metres
SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")
PERSPECTIVE = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
FISHEYE = "OPENCV_FISHEYE"

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Entry:
    """A frame whose image is there: its file as written, its settings, and the file itself."""

    file: Path
    settings: dict[str, Any]
    color: Path


def detect(path: Path) -> bool:
    """Whether it is such a json, or the folder of one."""
    if path.is_file():
        return path.suffix.lower() == ".json"
    return (path / LAYOUT).is_file()


def read(path: Path) -> SourceCapture:
    """The capture in its own world frame, in natural order of the images' paths.

    Raises:
        TFLabError: the json is missing or not one, or no frame is usable.
    """
    file = path if path.is_file() else path / LAYOUT
    document = _read_json(file)
    entries, skipped = _entries(file, document)
    default = _default_size(entries)
    found = []
    for entry in entries:
        try:
            found.append((entry, _pose(entry.settings), _camera(entry.settings, default)))
        except (ValueError, TFLabError) as error:
            skipped.append(f"{entry.file}: {error}")
    names = frame_names([entry.file for entry, _, _ in found])
    cameras = at_file_size(
        [camera for _, _, camera in found], [entry.color for entry, _, _ in found]
    )
    depths = _depths(file, document, [entry for entry, _, _ in found])
    frames = [
        SourceFrame(name, camera, pose, ColorFile(entry.color), depth)
        for name, camera, depth, (entry, pose, _) in zip(names, cameras, depths, found, strict=True)
    ]
    return collect(file.parent, frames, skipped, convention=CONVENTION)


def _read_json(file: Path) -> dict[str, Any]:
    cure = 'a transforms.json is {"frames": [...], ...} (see nerfstudio or instant-ngp)'
    try:
        document = json.loads(read_text(file, cure))
    except (ValueError, RecursionError) as error:
        raise TFLabError(f"{file}: not json ({str(error)[:80]}); {cure}") from error
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list) or not frames:
        raise TFLabError(f"{file}: no list of frames in it; {cure}")
    return dict(document)


def _entries(file: Path, document: dict[str, Any]) -> tuple[list[_Entry], list[str]]:
    """The frames with an image, in natural order, and what is wrong with the others."""
    entries, skipped = [], []
    for number, frame in enumerate(document["frames"]):
        path = frame.get("file_path") if isinstance(frame, dict) else None
        if not isinstance(path, str) or not path:
            skipped.append(f"frame {number}: no file_path")
            continue
        path = path.replace("\\", "/")  # written on Windows
        color = next(
            (c for c in (file.parent / f"{path}{s}" for s in SUFFIXES) if is_file(c)), None
        )
        if color is None:
            skipped.append(f"frame {number}: no image {path[:200]!r}")
            continue
        entries.append(_Entry(Path(path).parent / color.name, {**document, **frame}, color))
    return sorted(entries, key=lambda entry: natural_order(entry.file)), skipped


def _default_size(entries: list[_Entry]) -> tuple[int, int]:
    """The size of the images, where a frame does not state it."""
    if all("w" in entry.settings and "h" in entry.settings for entry in entries):
        return 0, 0
    return image_size([entry.color for entry in entries])


def _number(settings: dict[str, Any], key: str, default: float | None = None) -> float:
    """A finite number. Raises ValueError: it is missing, or something else."""
    value = settings.get(key, default)
    try:
        number = math.nan if isinstance(value, (bool, str)) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{key} is {str(value)[:40]!r}, not a number")
    return number


def _pose(settings: dict[str, Any]) -> np.ndarray:
    """world_T_cam [4, 4], OpenCV. Raises ValueError: it is none."""
    try:
        matrix = np.array(settings.get("transform_matrix"), np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise ValueError("its transform_matrix is not 4x4 or 3x4 numbers")
    pose = np.eye(4)
    pose[: len(matrix)] = matrix
    return opencv_of_opengl(pose)


def _camera(settings: dict[str, Any], default: tuple[int, int]) -> Camera:
    """The camera of a frame. Raises ValueError or TFLabError: it is not one, or not a known one."""
    width, height = (_number(settings, k, d) for k, d in zip("wh", default, strict=True))
    size = (round(width), round(height))
    if "fl_x" not in settings and "camera_angle_x" in settings:
        fx = 0.5 * width / math.tan(0.5 * _angle(settings, "camera_angle_x"))
    else:
        fx = _number(settings, "fl_x")
    if "fl_y" not in settings and "fl_x" not in settings and "camera_angle_y" in settings:
        fy = 0.5 * height / math.tan(0.5 * _angle(settings, "camera_angle_y"))
    else:
        fy = _number(settings, "fl_y", fx)
    cx, cy = _number(settings, "cx", width / 2), _number(settings, "cy", height / 2)
    model = settings.get("camera_model", FISHEYE if settings.get("is_fisheye") else "OPENCV")
    if model not in (*PERSPECTIVE, FISHEYE):
        raise ValueError(
            f"camera_model {str(model)[:40]!r} is unknown; known are {', '.join(PERSPECTIVE)} and "
            f"{FISHEYE}; undistort the images for one of these"
        )
    keys = ("k1", "k2", "k3", "k4") if model == FISHEYE else ("k1", "k2", "p1", "p2", "k3")
    if model != FISHEYE and _number(settings, "k4", 0):
        raise ValueError("k4 is for fisheye lenses; a perspective one has k1, k2, k3, p1, p2")
    distortion = tuple(_number(settings, key, 0) for key in keys)
    return Camera(
        size, fx, fy, cx - 0.5, cy - 0.5, distortion if any(distortion) else (), model == FISHEYE
    )


def _angle(settings: dict[str, Any], key: str) -> float:
    angle = _number(settings, key)
    if not 0 < angle < math.pi:
        raise ValueError(f"{key} is {angle:g}, not a field of view in radians")
    return angle


def _depths(file: Path, document: dict[str, Any], entries: list[_Entry]) -> list[DepthFile | None]:
    """Where the frames' depth maps are. Raises TFLabError: their unit is not one."""
    try:
        unit = _number(document, "depth_unit_scale_factor", DEPTH_UNIT)
        if unit <= 0:
            raise ValueError(f"depth_unit_scale_factor is {unit:g}: metres a unit, positive")
    except ValueError as error:
        raise TFLabError(f"{file}: {error}") from error
    paths = [entry.settings.get("depth_file_path") for entry in entries]
    named = [file.parent / p.replace("\\", "/") if isinstance(p, str) else None for p in paths]
    depths = [DepthFile(d, 1 / unit) if d is not None and is_file(d) else None for d in named]
    if missing := sum(d is not None for d in named) - sum(d is not None for d in depths):
        logger.warning("%s: %d of its depth files are missing", file, missing)
    if not any(depths):
        logger.warning("%s: it states no unit of length; its poses are taken as metres", file)
    return depths
