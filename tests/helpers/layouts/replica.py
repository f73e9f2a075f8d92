"""results/, traj.txt and ../cam_params.json of Replica as NICE-SLAM publishes it; z up."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings()  # the format says where down is
SCALE = 6553.5  # units of depth a metre


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    scene = directory / "room0"
    (scene / "results").mkdir(parents=True)
    (fx, _, cx), (_, fy, cy), _ = frames[0].K.tolist()
    height, width = frames[0].image.shape[:2]
    camera = {"w": width, "h": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "scale": SCALE}
    (directory / "cam_params.json").write_text(json.dumps({"camera": camera}))
    np.savetxt(scene / "traj.txt", [frame.world_T_cam.ravel() for frame in frames], fmt="%.18e")
    for i, frame in enumerate(frames):
        Image.fromarray(frame.image).save(scene / "results" / f"frame{i:06d}.png")
        units = np.round(frame.depth * SCALE).astype(np.uint16)
        Image.fromarray(units).save(scene / "results" / f"depth{i:06d}.png")
    return scene
