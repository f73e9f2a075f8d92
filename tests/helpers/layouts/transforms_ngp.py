"""transforms.json of instant-ngp with depth, its rotations scaled as Blender's exporters do."""

import json
from collections.abc import Sequence
from pathlib import Path

from helpers.layouts import transforms
from helpers.layouts.transforms import OPTIONS as OPTIONS
from tf_lab.data.scene import Frame

SCALE = 0.25


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    transforms.write(directory, frames)
    document = json.loads((directory / "transforms.json").read_text())
    document["integer_depth_scale"] = document.pop("depth_unit_scale_factor")
    for frame in document["frames"]:
        frame["depth_path"] = frame.pop("depth_file_path")
        frame["transform_matrix"] = [
            [SCALE * value for value in row[:3]] + row[3:] for row in frame["transform_matrix"][:3]
        ]
    (directory / "transforms.json").write_text(json.dumps(document))
    return directory
