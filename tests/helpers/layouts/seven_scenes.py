"""frame-XXXXXX.{color.png,depth.png,pose.txt}, camera-intrinsics.txt."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings(gravity=(0, 0, -1))


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    directory.mkdir(parents=True, exist_ok=True)
    np.savetxt(directory / "camera-intrinsics.txt", frames[0].K, fmt="%.17g")
    for i, frame in enumerate(frames):
        stem = directory / f"frame-{i:06d}"
        Image.fromarray(frame.image).save(f"{stem}.color.png")
        millimetres = np.round(frame.depth * 1000).astype(np.uint16)
        Image.fromarray(millimetres).save(f"{stem}.depth.png")
        np.savetxt(f"{stem}.pose.txt", frame.world_T_cam, fmt="%.17g")
    return directory
