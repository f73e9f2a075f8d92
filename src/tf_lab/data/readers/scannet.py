"""ScanNet: a scene's frames from its ``.sens`` stream or from what ScanNet's tool exported of it.

::

    scene0000_00.sens                 the stream itself (see `sens`), or the folder that holds it
    color/0.jpg, depth/0.png          an export: colour; 16-bit millimetres, 0 = no reading
    pose/0.txt                        4x4, camera to world; -inf: lost
    intrinsic/intrinsic_color.txt     4x4, and intrinsic_depth.txt; extrinsic_color.txt and
                                      extrinsic_depth.txt (the identity if missing); of
                                      scannet_frames_25k intrinsics_color.txt beside color/

Depth has a camera of its own, and often another size than colour. The extrinsics lead from a camera
to the frame common to both, so color_T_depth = inverse(extrinsic_color) extrinsic_depth; they are
the identity in the published scans, which were calibrated. Where they are not, the pose is that of
the depth camera, as in the authors' point clouds. The world is metric, its z axis points up.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from tf_lab.data.lens import Camera, camera_of
from tf_lab.data.readers.images import image_files, image_size, match_depths
from tf_lab.data.readers.parsing import read_pose
from tf_lab.data.readers.sens import open_sens
from tf_lab.data.readers.source import (
    ColorFile,
    DepthFile,
    Rig,
    SourceCapture,
    collect,
)
from tf_lab.errors import TFLabError
from tf_lab.geometry import is_valid_pose
from tf_lab.support.arrays import read_array

NAME = "scannet"
LAYOUT = "SCENE.sens, or color/, pose/, intrinsic/intrinsic_color.txt"
DOWN = (0.0, 0.0, -1.0)
CURE = "ScanNet's exporter writes 4x4 numbers there"


def detect(path: Path) -> bool:
    """Whether it is a stream, or a folder with one or with an export."""
    if path.is_file():
        return path.suffix.lower() == ".sens"
    return _is_export(path) or any(path.glob("*.sens"))


def read(path: Path) -> SourceCapture:
    """The scene in ScanNet's world frame; of a folder with stream and export, the export.

    Raises:
        TFLabError: a part is missing or damaged, or no frame is usable.
    """
    if path.is_dir() and not _is_export(path):
        streams = sorted(path.glob("*.sens"))
        if len(streams) != 1:
            found = f"{len(streams)} .sens files" if streams else f"neither of {LAYOUT}"
            raise TFLabError(f"{path}: {found} in it; give the folder of one scene, or the file")
        return _read_stream(path, streams[0])
    return _read_export(path) if path.is_dir() else _read_stream(path, path)


def _is_export(path: Path) -> bool:
    parts = (path / "color", path / "pose")
    return all(part.is_dir() for part in parts) and _intrinsics(path, "color").is_file()


def camera_of_matrix(K: np.ndarray, size: tuple[int, int], where: str) -> Camera:
    """The camera of intrinsics [4, 4]. Raises TFLabError, naming ``where``."""
    try:
        return camera_of(K[:3, :3], size)
    except TFLabError as error:
        raise TFLabError(f"{where}: {error}") from error


def rigid(extrinsics: np.ndarray, where: str) -> np.ndarray:
    """The extrinsics [4, 4]. Raises TFLabError, naming ``where``: they are no rigid transform."""
    if not is_valid_pose(torch.from_numpy(extrinsics)):
        raise TFLabError(f"{where}: these extrinsics are not a rigid transform")
    return extrinsics


def color_T_depth_of(color: np.ndarray, depth: np.ndarray) -> np.ndarray | None:
    """From both extrinsics [4, 4]; None for the identity."""
    color_T_depth = np.linalg.inv(color) @ depth
    return None if np.allclose(color_T_depth, np.eye(4), atol=1e-6) else color_T_depth


def _read_stream(source: Path, path: Path) -> SourceCapture:
    sens = open_sens(path)
    header = sens.header
    depth = None
    if header.depth_size != (0, 0):
        depth = camera_of_matrix(header.depth_K, header.depth_size, f"{path}, depth")
    rig = Rig(
        camera_of_matrix(header.color_K, header.color_size, f"{path}, colour"),
        depth,
        color_T_depth_of(
            rigid(header.color_extrinsics, f"{path}, colour"),
            rigid(header.depth_extrinsics, f"{path}, depth"),
        ),
    )
    frames = [
        rig.frame(str(frame.color.block.frame), frame.pose, frame.color, frame.depth)
        for frame in sens.frames
    ]
    return collect(source, frames, sens.missing, DOWN)


def _read_export(directory: Path) -> SourceCapture:
    colors = {path.stem: path for path in image_files(directory / "color")}
    if not colors:
        raise TFLabError(f"{directory / 'color'}: no JPEG or PNG image in it; export the scene")
    color, depth = _export_camera(directory, "color", list(colors.values())), None
    depths = match_depths(directory / "depth", list(colors.values()))
    if depths:
        depth = _export_camera(directory, "depth", list(depths.values()))
    extrinsics = _extrinsics(directory, "color"), _extrinsics(directory, "depth")
    rig = Rig(color, depth, color_T_depth_of(*extrinsics))
    posed = {path.stem for path in (directory / "pose").glob("*.txt")}
    skipped = [f"{name}: no colour image" for name in sorted(posed - colors.keys())]
    frames = []
    for name, image in colors.items():
        if name not in posed:
            skipped.append(f"{name}: no pose")
            continue
        try:
            pose = read_pose(directory / "pose" / f"{name}.txt", CURE)
        except TFLabError as error:
            skipped.append(f"{name}: {error}")
            continue
        file = DepthFile(depths[image]) if image in depths else None
        frames.append(rig.frame(name, pose, ColorFile(image), file))
    return collect(directory, frames, skipped, DOWN)


def _intrinsics(directory: Path, camera: str) -> Path:
    path = directory / "intrinsic" / f"intrinsic_{camera}.txt"
    of_25k = directory / f"intrinsics_{camera}.txt"
    return of_25k if of_25k.is_file() and not path.is_file() else path


def _export_camera(directory: Path, camera: str, images: Sequence[Path]) -> Camera:
    path = _intrinsics(directory, camera)
    K = read_pose(path, CURE)
    arrays = [image for image in images if image.suffix == ".npy"]
    if arrays:
        height, width, *_ = read_array(arrays[0], "write it again").shape
        return camera_of_matrix(K, (width, height), str(path))
    return camera_of_matrix(K, image_size(images, (K[0, 2], K[1, 2])), str(path))


def _extrinsics(directory: Path, camera: str) -> np.ndarray:
    path = directory / "intrinsic" / f"extrinsic_{camera}.txt"
    return rigid(read_pose(path, CURE), str(path)) if path.exists() else np.eye(4)
