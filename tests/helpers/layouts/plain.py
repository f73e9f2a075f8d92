"""images/, poses.txt, K.txt, depth/."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings(gravity=(0, 0, -1))


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    (directory / "images").mkdir(parents=True)
    (directory / "depth").mkdir()
    np.savetxt(directory / "K.txt", frames[0].K, fmt="%.17g")
    poses = np.stack([frame.world_T_cam.reshape(16) for frame in frames])
    np.savetxt(directory / "poses.txt", poses, fmt="%.17g")
    for i, frame in enumerate(frames):
        Image.fromarray(frame.image).save(directory / "images" / f"{i}.png")
        millimetres = np.round(frame.depth * 1000).astype(np.uint16)
        Image.fromarray(millimetres).save(directory / "depth" / f"{i}.png")
    return directory
