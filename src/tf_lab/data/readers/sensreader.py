"""What the C++ SensReader of ScanNet makes of a .sens file; 3RScan's sequences are so, too.

::

    _info.txt                   "m_colorWidth = 1296" and so on: sizes, intrinsics and extrinsics of
                                both cameras (4x4), m_depthShift (units of depth a metre)
    frame-000000.color.jpg
    frame-000000.depth.pgm      16-bit, big-endian, 0 = no reading (optional)
    frame-000000.pose.txt       4x4, camera to world; -inf: lost

Cameras and world are those of `scannet`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tf_lab.data.readers.images import image_files
from tf_lab.data.readers.parsing import parse_pose, read_pose
from tf_lab.data.readers.scannet import DOWN, camera_of_matrix, color_T_depth_of, rigid
from tf_lab.data.readers.source import ColorFile, DepthFile, Rig, SourceCapture, collect
from tf_lab.errors import TFLabError
from tf_lab.support.text import read_lines

NAME = "sensreader"
LAYOUT = "_info.txt, frame-XXXXXX.color.jpg, frame-XXXXXX.pose.txt"
INFO = "_info.txt"
CURE = "SensReader writes it with the frames"


def detect(directory: Path) -> bool:
    """Whether there are colour images and what belongs to them."""
    return (directory / INFO).is_file() and any(directory.glob("frame-*.color.*"))


def read(directory: Path) -> SourceCapture:
    """The scene in ScanNet's world.

    Raises:
        TFLabError: a part is missing or damaged, or no frame is usable.
    """
    rig, scale = _cameras(directory / INFO)
    frames, skipped = [], []
    for color in image_files(directory):
        name = color.name.split(".")[0]
        if not color.stem.endswith(".color"):
            continue
        try:
            pose = read_pose(directory / f"{name}.pose.txt", CURE)
        except TFLabError as error:
            skipped.append(f"{name}: {error}")
            continue
        file = directory / f"{name}.depth.pgm"
        depth = DepthFile(file, scale) if file.is_file() and rig.depth is not None else None
        frames.append(rig.frame(name, pose, ColorFile(color), depth))
    return collect(directory, frames, skipped, DOWN)


def _cameras(file: Path) -> tuple[Rig, float]:
    """Both cameras, and the units of depth a metre."""
    lines = (line.partition("=") for _, line in read_lines(file, CURE))
    values = {name.strip().removeprefix("m_"): value for name, _, value in lines}
    try:
        scale = float(values["depthShift"])
        if not (np.isfinite(scale) and scale > 0):
            raise ValueError(f"m_depthShift is {scale:g}: units of depth a metre, positive")
        sizes, matrices = {}, {}
        for kind in ("color", "depth"):
            sizes[kind] = int(values[f"{kind}Width"]), int(values[f"{kind}Height"])
            for what in ("Intrinsic", "Extrinsic"):
                name = f"calibration{kind.capitalize()}{what}"
                matrices[kind, what] = parse_pose(values[name])
    except KeyError as error:
        raise TFLabError(f"{file}: no line m_{error.args[0]} = ... in it; {CURE}") from error
    except ValueError as error:
        raise TFLabError(f"{file}: {error}; {CURE}") from error
    color, depth = (
        None
        if sizes[kind] == (0, 0)
        else camera_of_matrix(matrices[kind, "Intrinsic"], sizes[kind], f"{file}, {kind}")
        for kind in ("color", "depth")
    )
    if color is None:
        raise TFLabError(f"{file}: no colour camera in it; {CURE}")
    extrinsics = (rigid(matrices[kind, "Extrinsic"], f"{file}, {kind}") for kind in sizes)
    return Rig(color, depth, color_T_depth_of(*extrinsics)), scale
