"""transforms_train.json and its siblings of the NeRF authors: a field of view, no suffixes."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from helpers.layouts.transforms import OPTIONS as OPTIONS, opengl
from tf_lab.data.scene import Frame


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    width = frames[0].image.shape[1]
    third = len(frames) // 3
    for split, start in (
        ("train", 0),
        ("val", len(frames) - 2 * third),
        ("test", len(frames) - third),
    ):
        (directory / split).mkdir(parents=True)
        end = len(frames) - 2 * third if split == "train" else start + third
        entries = []
        for i in range(start, end):
            Image.fromarray(frames[i].image).save(directory / split / f"r_{i}.png")
            entries.append({"file_path": f"./{split}/r_{i}", "rotation": 0.01,
                            "transform_matrix": opengl(frames[i]).tolist()})  # fmt: skip
        angle = 2 * math.atan(0.5 * width / frames[0].K[0, 0])
        document = {"camera_angle_x": angle, "frames": entries}
        (directory / f"transforms_{split}.json").write_text(json.dumps(document))
    return directory
