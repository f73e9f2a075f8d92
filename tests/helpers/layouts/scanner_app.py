"""frame_XXXXX.{png,json}, depth_XXXXX.png, conf_XXXXX.png of 3D Scanner App: a y-up world."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from helpers.layouts.arkit import arkit_pose
from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings()  # the format says where down is


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open: every second json has no picture."""
    directory.mkdir(parents=True)
    (directory / "info.json").write_text("{}")
    for i, frame in enumerate(frames):
        (fx, _, cx), (_, fy, cy), _ = frame.K.tolist()
        document = {
            "cameraPoseARFrame": arkit_pose(frame).ravel().tolist(),
            "intrinsics": [fx, 0, cx + 0.5, 0, fy, cy + 0.5, 0, 0, 1],
            "frame_index": 2 * i,
            "time": i / 30,
        }
        for number in (2 * i, 2 * i + 1):
            (directory / f"frame_{number:05d}.json").write_text(json.dumps(document))
        Image.fromarray(frame.image).save(directory / f"frame_{2 * i:05d}.png")
        millimetres = np.round(frame.depth * 1000).astype(np.uint16)
        Image.fromarray(millimetres).save(directory / f"depth_{2 * i:05d}.png")
        levels = np.full(millimetres.shape, 2, np.uint8)
        Image.fromarray(levels).save(directory / f"conf_{2 * i:05d}.png")
    return directory
