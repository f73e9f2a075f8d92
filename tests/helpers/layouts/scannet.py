"""A ScanNet scene as its SensReader exports it: color/, depth/, pose/, intrinsic/."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings()  # the format says where down is


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    for name in ("color", "depth", "pose", "intrinsic"):
        (directory / name).mkdir(parents=True)
    intrinsics = np.eye(4)
    intrinsics[:3, :3] = frames[0].K
    for camera in ("color", "depth"):
        np.savetxt(directory / "intrinsic" / f"intrinsic_{camera}.txt", intrinsics, fmt="%.6f")
        np.savetxt(directory / "intrinsic" / f"extrinsic_{camera}.txt", np.eye(4), fmt="%.6f")
    for i, frame in enumerate(frames):
        # SensReader copies the JPEG of the stream; here PNG, so that images can be compared
        Image.fromarray(frame.image).save(directory / "color" / f"{i}.png")
        millimetres = np.round(frame.depth * 1000).astype(np.uint16)
        Image.fromarray(millimetres).save(directory / "depth" / f"{i}.png")
        np.savetxt(directory / "pose" / f"{i}.txt", frame.world_T_cam, fmt="%.6f")
    return directory
