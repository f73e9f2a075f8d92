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
the middle of the image without cx, cy, and w, h are those of the images. nerfstudio's depth is in
units of ``depth_unit_scale_factor`` metres, 0.001 without it; instant-ngp calls the file
``depth_path`` and needs the unit, ``integer_depth_scale``. Where ``transforms_train.json``,
``transforms_val.json`` and ``transforms_test.json`` stand instead, the capture is all of them, in
this order.

Camera axes are OpenGL's: x right, y up, z back. cx, cy are measured from the corner of the image:
both programs put the centre of the first pixel at (0.5, 0.5) when they cast its ray, and take cx
from COLMAP, which does so too. The format has no unit of length (converters from COLMAP write any)
and no gravity: the poses are taken as metres.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tf_lab.data.lens import Camera
from tf_lab.data.readers.fields import number, numbers, read_document
from tf_lab.data.readers.images import (
    at_file_size,
    frame_names,
    image_size,
    in_order,
    is_file,
)
from tf_lab.data.readers.parsing import opencv_of_opengl
from tf_lab.data.readers.source import ColorFile, DepthFile, SourceCapture, SourceFrame, collect
from tf_lab.data.reading import Convention
from tf_lab.errors import TFLabError

NAME = "transforms"
LAYOUT = "transforms.json, or transforms_train.json"
CONVENTION = Convention(axes="opengl")
WHOLE = "transforms.json"
SPLITS = tuple(f"transforms_{split}.json" for split in ("train", "val", "test"))
NGP_UNIT = "integer_depth_scale"
DEPTHS = (  # the key of a depth map, that of its unit in metres, and what this is without it
    ("depth_file_path", "depth_unit_scale_factor", 0.001),
    ("depth_path", NGP_UNIT, None),
)
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
    return any((path / name).is_file() for name in (WHOLE, SPLITS[0]))


def read(path: Path) -> SourceCapture:
    """The capture in its own world frame, in natural order of the images' paths.

    Raises:
        TFLabError: a json is missing or not one, or no frame is usable.
    """
    folder = path.parent if path.is_file() else path
    entries, skipped = [], []
    for file in _files(path):
        found, lost = _entries(file, _read(file))
        entries += found
        skipped += lost
    default = _default_size(entries)
    posed = []
    for entry in entries:
        try:
            posed.append((entry, _pose(entry.settings), _camera(entry.settings, default)))
        except (ValueError, TFLabError) as error:
            skipped.append(f"{entry.file}: {error}")
    names = frame_names([entry.file for entry, _, _ in posed])
    cameras = at_file_size(
        [camera for _, _, camera in posed], [entry.color for entry, _, _ in posed]
    )
    depths = _depths(folder, [entry for entry, _, _ in posed])
    frames = [
        SourceFrame(name, camera, pose, ColorFile(entry.color), depth, stated=stated)
        for name, camera, depth, (entry, pose, stated) in zip(
            names, cameras, depths, posed, strict=True
        )
    ]
    return collect(folder, frames, skipped, convention=CONVENTION)


def _files(path: Path) -> list[Path]:
    """The json files of a capture."""
    if path.is_file():
        return [path]
    splits = [path / name for name in SPLITS if (path / name).is_file()]
    return [path / WHOLE] if (path / WHOLE).is_file() or not splits else splits


def _read(file: Path) -> dict[str, Any]:
    cure = 'a transforms.json is {"frames": [...], ...} (see nerfstudio or instant-ngp)'
    document = read_document(file, cure)
    frames = document.get("frames")
    if not isinstance(frames, list) or not frames:
        raise TFLabError(f"{file}: no list of frames in it; {cure}")
    return document


def _entries(file: Path, document: dict[str, Any]) -> tuple[list[_Entry], list[str]]:
    """The frames with an image, in natural order, and what is wrong with the others."""
    entries, skipped = [], []
    for i, frame in enumerate(document["frames"]):
        path = frame.get("file_path") if isinstance(frame, dict) else None
        if not isinstance(path, str) or not path:
            skipped.append(f"frame {i}: no file_path")
            continue
        path = path.replace("\\", "/")  # written on Windows
        color = next(
            (c for c in (file.parent / f"{path}{s}" for s in SUFFIXES) if is_file(c)), None
        )
        if color is None:
            skipped.append(f"frame {i}: no image {path[:200]!r}")
            continue
        entries.append(_Entry(Path(path).parent / color.name, {**document, **frame}, color))
    return in_order(entries, lambda entry: entry.file), skipped


def _default_size(entries: list[_Entry]) -> tuple[int, int]:
    """The size of the images, where a frame does not state it."""
    if all("w" in entry.settings and "h" in entry.settings for entry in entries):
        return 0, 0
    first = entries[0].settings
    try:
        centre = (number(first, "cx") - 0.5, number(first, "cy") - 0.5)
    except ValueError:  # not stated
        centre = None
    return image_size([entry.color for entry in entries], centre)


def _pose(settings: dict[str, Any]) -> np.ndarray:
    """world_T_cam [4, 4], OpenCV. Raises ValueError: it is none."""
    matrix = numbers(settings, "transform_matrix", 16, 12).reshape(-1, 4)
    pose = np.eye(4)
    pose[: len(matrix)] = matrix
    return opencv_of_opengl(pose)


def _camera(settings: dict[str, Any], default: tuple[int, int]) -> Camera:
    """The camera of a frame. Raises ValueError or TFLabError: it is not one, or not a known one."""
    width, height = (number(settings, k, d) for k, d in zip("wh", default, strict=True))
    size = (round(width), round(height))
    if "fl_x" not in settings and "camera_angle_x" in settings:
        fx = 0.5 * width / math.tan(0.5 * _angle(settings, "camera_angle_x"))
    else:
        fx = number(settings, "fl_x")
    if "fl_y" not in settings and "fl_x" not in settings and "camera_angle_y" in settings:
        fy = 0.5 * height / math.tan(0.5 * _angle(settings, "camera_angle_y"))
    else:
        fy = number(settings, "fl_y", fx)
    cx, cy = number(settings, "cx", width / 2), number(settings, "cy", height / 2)
    model = settings.get("camera_model", FISHEYE if settings.get("is_fisheye") else "OPENCV")
    if model not in (*PERSPECTIVE, FISHEYE):
        raise ValueError(
            f"camera_model {str(model)[:40]!r} is unknown; known are {', '.join(PERSPECTIVE)} and "
            f"{FISHEYE}; undistort the images for one of these"
        )
    keys = ("k1", "k2", "k3", "k4") if model == FISHEYE else ("k1", "k2", "p1", "p2", "k3")
    if model != FISHEYE and number(settings, "k4", 0):
        raise ValueError("k4 is for fisheye lenses; a perspective one has k1, k2, k3, p1, p2")
    distortion = tuple(number(settings, key, 0) for key in keys)
    return Camera(
        size, fx, fy, cx - 0.5, cy - 0.5, distortion if any(distortion) else (), model == FISHEYE
    )


def _angle(settings: dict[str, Any], key: str) -> float:
    angle = number(settings, key)
    if not 0 < angle < math.pi:
        raise ValueError(f"{key} is {angle:g}, not a field of view in radians")
    return angle


def _depths(folder: Path, entries: list[_Entry]) -> list[DepthFile | None]:
    """Where the frames' depth maps are. Raises TFLabError: their unit is not one."""
    try:
        named = [_depth(folder, entry.settings) for entry in entries]
    except ValueError as error:
        raise TFLabError(f"{folder}: {error}") from error
    depths = [depth if depth is not None and is_file(depth.path) else None for depth in named]
    if missing := sum(d is not None for d in named) - sum(d is not None for d in depths):
        logger.warning("%s: %d of its depth files are missing", folder, missing)
    if any("depth_path" in e.settings and NGP_UNIT not in e.settings for e in entries):
        logger.warning("%s: depth_path without %s is left out: its unit is unknown; give %s, "
                       "metres a unit", folder, NGP_UNIT, NGP_UNIT)  # fmt: skip
    if not any(depths):
        logger.warning("%s: it states no unit of length; its poses are taken as metres", folder)
    return depths


def _depth(folder: Path, settings: dict[str, Any]) -> DepthFile | None:
    """The depth map that a frame names, there or not. Raises ValueError: its unit is not one."""
    for key, unit, default in DEPTHS:
        path = settings.get(key)
        if isinstance(path, str) and (unit in settings or default is not None):
            metres = number(settings, unit, default)
            if metres <= 0:
                raise ValueError(f"{unit} is {metres:g}: metres a unit, positive")
            return DepthFile(folder / path.replace("\\", "/"), 1 / metres)
    return None
