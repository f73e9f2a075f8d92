"""images/ and sparse/*.bin of COLMAP: the model of `colmap_text`, little-endian."""

import struct
from collections.abc import Sequence
from pathlib import Path

from helpers.layouts import colmap_text
from helpers.layouts.colmap_text import OPTIONS as OPTIONS
from tf_lab.data.scene import Frame


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    names = colmap_text.write_images(directory, frames)
    model = directory / "sparse"
    model.mkdir()
    (fx, _, cx), (_, fy, cy), _ = frames[0].K.tolist()
    height, width = frames[0].image.shape[:2]
    with (model / "cameras.bin").open("wb") as file:
        file.write(struct.pack("<Q", 1))
        file.write(struct.pack("<IiQQ4d", 3, 1, width, height, fx, fy, cx + 0.5, cy + 0.5))
    with (model / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(frames)))
        for i, (name, frame) in enumerate(zip(names, frames, strict=True)):
            quaternion, translation = colmap_text.cam_T_world(frame)
            file.write(struct.pack("<I7dI", 100 - i, *quaternion, *translation, 3))
            file.write(name.encode() + b"\0")
            points = [(10.5, 20.25, 7), (11.5, 3.0, 2**64 - 1)][: i % 3]
            file.write(struct.pack("<Q", len(points)))
            for point in points:
                file.write(struct.pack("<ddQ", *point))
    (model / "points3D.bin").write_bytes(struct.pack("<Q", 0))
    return directory
