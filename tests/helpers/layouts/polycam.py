"""keyframes/ of Polycam's raw data: corrected images and cameras, depth, confidence; y up."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from helpers.layouts.arkit import arkit_pose
from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings()  # the format says where down is
START = 1442008525605  # microseconds


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    folders = ("corrected_images", "corrected_cameras", "images", "cameras", "depth", "confidence")
    images, cameras, _, recorded, depths, confidences = (
        directory / "keyframes" / f for f in folders
    )
    for folder in folders:
        (directory / "keyframes" / folder).mkdir(parents=True)
    for i, frame in enumerate(frames):
        name = str(START + 33333 * i)
        (fx, _, cx), (_, fy, cy), _ = frame.K.tolist()
        height, width = frame.image.shape[:2]
        document = {
            "fx": fx,
            "fy": fy,
            "cx": cx + 0.5,
            "cy": cy + 0.5,
            "width": width,
            "height": height,
        }
        document |= {f"t_{row}{column}": float(arkit_pose(frame)[row, column])
                     for row in range(3) for column in range(4)}  # fmt: skip
        (cameras / f"{name}.json").write_text(json.dumps({**document, "blur_score": 120.5}))
        (recorded / f"{name}.json").write_text(json.dumps({**document, "t_03": 9.0}))  # drifted
        Image.fromarray(frame.image).save(images / f"{name}.png")
        millimetres = np.round(frame.depth * 1000).astype(np.uint16)
        Image.fromarray(millimetres).save(depths / f"{name}.png")
        levels = np.full(millimetres.shape, (54, 255)[i % 2], np.uint8)
        Image.fromarray(levels).save(confidences / f"{name}.png")
    return directory
