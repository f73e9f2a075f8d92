"""rgb.mp4, odometry.csv, camera_matrix.csv, depth/, confidence/ of Stray Scanner: a y-up world."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from helpers.layouts.arkit import ARKIT_R_WORLD
from helpers.layouts.video import write_video
from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings()  # the format says where down is


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    for name in ("depth", "confidence"):
        (directory / name).mkdir(parents=True)
    write_video(directory / "rgb.mov", [frame.image for frame in frames])
    (directory / "rgb.mov").rename(directory / "rgb.mp4")
    (fx, _, cx), (_, fy, cy), _ = frames[0].K
    (directory / "camera_matrix.csv").write_text(
        f"{fx:f}, 0.0, {cx + 0.5:f}\n0.0, {fy:f}, {cy + 0.5:f}\n0.0, 0.0, 1.0\n"
    )
    lines = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for i, frame in enumerate(frames):
        rotation = ARKIT_R_WORLD @ frame.world_T_cam[:3, :3]
        values = [
            *(ARKIT_R_WORLD @ frame.world_T_cam[:3, 3]),
            *Rotation.from_matrix(rotation).as_quat(),
        ]
        lines.append(f"{1000 + i / 60:.6f}, {i:06d}, " + ", ".join(f"{v:.7f}" for v in values))
        millimetres = np.round(frame.depth * 1000).astype(np.uint16)
        Image.fromarray(millimetres).save(directory / "depth" / f"{i:06d}.png")
        levels = np.full(millimetres.shape, 1 + i % 2, np.uint8)  # medium or high
        Image.fromarray(levels).save(directory / "confidence" / f"{i:06d}.png")
    (directory / "odometry.csv").write_text("\n".join(lines) + "\n")
    return directory
