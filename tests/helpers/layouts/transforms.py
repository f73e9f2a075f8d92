"""transforms.json of nerfstudio: OpenGL's camera axes, pixel centres at 0.5, depth in 0.1 mm."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings(gravity=(0, 0, -1))


def opengl(frame: Frame) -> np.ndarray:
    """Camera to world [4, 4] with the camera's axes x right, y up, z back."""
    right, down, forward, centre = frame.world_T_cam[:3].T
    return np.vstack([np.stack([right, -down, -forward, centre], axis=1), [0, 0, 0, 1]])


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    (directory / "images").mkdir(parents=True)
    (directory / "depth").mkdir()
    entries = []
    for i, frame in enumerate(frames):
        Image.fromarray(frame.image).save(directory / "images" / f"frame_{i}.png")
        units = np.round(frame.depth * 10000).astype(np.uint16)
        Image.fromarray(units).save(directory / "depth" / f"frame_{i}.png")
        entries.append(
            {
                "file_path": f"images/frame_{i}.png",
                "depth_file_path": f"depth/frame_{i}.png",
                "transform_matrix": opengl(frame).tolist(),
            }
        )
    height, width = frames[0].image.shape[:2]
    (fx, _, cx), (_, fy, cy), _ = frames[0].K.tolist()
    camera = {"fl_x": fx, "fl_y": fy, "cx": cx + 0.5, "cy": cy + 0.5, "w": width, "h": height}
    lens = {"camera_model": "OPENCV", "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0}
    document = {**camera, **lens, "depth_unit_scale_factor": 0.0001, "frames": entries}
    (directory / "transforms.json").write_text(json.dumps(document, indent=2))
    return directory
