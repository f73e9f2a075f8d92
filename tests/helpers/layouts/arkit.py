"""Frames.m4v, Frames.txt, ARposes.txt of ios_logger: a y-up world, OpenGL's camera axes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from helpers.layouts.transforms import opengl
from helpers.layouts.video import write_video
from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings()
START, RATE = 1700000000.25, 30.0
# our world's x, y, z are ARKit's x, -z, y
ARKIT_R_WORLD = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def arkit_pose(frame: Frame) -> np.ndarray:
    """Camera to world [4, 4] as ARKit gives it: OpenGL's camera axes, y up."""
    arkit_T_world = np.eye(4)
    arkit_T_world[:3, :3] = ARKIT_R_WORLD
    return arkit_T_world @ opengl(frame)


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    directory.mkdir(parents=True)
    write_video(directory / "walk.mov", [frame.image for frame in frames])
    (directory / "walk.mov").rename(directory / "Frames.m4v")
    images, poses = [], []
    for i, frame in enumerate(frames):
        (fx, _, cx), (_, fy, cy), _ = frame.K
        intrinsics = f"{fx:f},{fy:f},{cx + 0.5:f},{cy + 0.5:f}"
        images.append(f"{START + i / RATE:f},{i},{intrinsics}")
        arkit_T_cam = arkit_pose(frame)
        qx, qy, qz, qw = Rotation.from_matrix(arkit_T_cam[:3, :3]).as_quat()
        x, y, z = arkit_T_cam[:3, 3]
        pose = f"{x:f},{y:f},{z:f},{qw:f},{qx:f},{qy:f},{qz:f}"
        poses.append(f"{START + i / RATE:f},{pose}")
        # ARKit goes on while a frame is written: poses without an image
        poses.append(f"{START + (i + 0.5) / RATE:f},9,9,9,1,0,0,0")
    for name, lines in (("Frames.txt", images), ("ARposes.txt", poses)):
        (directory / name).write_text("".join(f"{line}\r\n" for line in lines), newline="")
    return directory
