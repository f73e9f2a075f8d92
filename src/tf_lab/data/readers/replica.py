"""A scene of Replica as rendered for iMAP and published with NICE-SLAM.

::

    results/frame000000.jpg     colour
    results/depth000000.png     16-bit, camera z (optional)
    traj.txt                    line i: 4x4 of frame i, camera to world, metres, row by row
    ../cam_params.json          "camera": {"w", "h", "fx", "fy", "cx", "cy", pixels; "scale": units
                                of depth a metre}; here or beside the scenes

Camera axes are x right, y down, z forward. The world is Replica's, its z axis points up.
"""

from __future__ import annotations

import re
from pathlib import Path

from tf_lab.data.lens import Camera
from tf_lab.data.readers.fields import number, read_document
from tf_lab.data.readers.images import image_files
from tf_lab.data.readers.parsing import read_poses
from tf_lab.data.readers.source import ColorFile, DepthFile, SourceCapture, SourceFrame, collect
from tf_lab.errors import TFLabError

NAME = "replica"
LAYOUT = "results/frameXXXXXX.jpg, traj.txt, cam_params.json"
DOWN = (0.0, 0.0, -1.0)
PARAMETERS = "cam_params.json"


def detect(directory: Path) -> bool:
    """Whether images and poses lie where this layout has them."""
    return (directory / "results").is_dir() and (directory / "traj.txt").is_file()


def read(directory: Path) -> SourceCapture:
    """The scene in Replica's world.

    Raises:
        TFLabError: a part is missing or damaged, or no frame is usable.
    """
    file = _parameters_file(directory)
    camera, scale = _parameters(file)
    poses = read_poses(directory / "traj.txt", f"{LAYOUT} belong together")
    results = directory / "results"
    frames, skipped = [], []
    for color in image_files(results) if results.is_dir() else []:
        named = re.fullmatch(r"frame(\d{1,9})", color.stem)
        if named is None:
            continue
        if int(named[1]) >= len(poses):
            skipped.append(f"{color.stem}: traj.txt has only {len(poses)} lines")
            continue
        path = results / f"depth{named[1]}.png"
        depth = DepthFile(path, scale) if path.is_file() else None
        frames.append(
            SourceFrame(color.stem, camera, poses[int(named[1])], ColorFile(color), depth)
        )
    return collect(directory, frames, skipped, DOWN, beside=[file])


def _parameters_file(directory: Path) -> Path:
    folders = (directory, directory.parent, directory.resolve().parent)
    places = [folder / PARAMETERS for folder in folders]
    return next((place for place in places if place.is_file()), places[0])


def _parameters(file: Path) -> tuple[Camera, float]:
    """The camera, and the units of depth a metre."""
    cure = '{"camera": {"w", "h", "fx", "fy", "cx", "cy", "scale"}}, beside the scene or in it'
    document = read_document(file, cure).get("camera")
    if not isinstance(document, dict):
        raise TFLabError(f"{file}: no camera in it; {cure}")
    try:
        width, height, fx, fy, cx, cy, scale = (
            number(document, key) for key in ("w", "h", "fx", "fy", "cx", "cy", "scale")
        )
        if scale <= 0:
            raise ValueError(f"scale is {scale:g}: units of depth a metre, positive")
        return Camera((round(width), round(height)), fx, fy, cx, cy), scale
    except (ValueError, TFLabError) as error:
        raise TFLabError(f"{file}: {error}") from error
