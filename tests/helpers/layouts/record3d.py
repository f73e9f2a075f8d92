"""metadata.json, rgb/, depth/ of Record3D: OpenGL's camera axes, depth as bare float32."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings(gravity=(0, 0, -1))


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    for name in ("rgb", "depth"):
        (directory / name).mkdir(parents=True)
    poses = []
    for i, frame in enumerate(frames):
        right, down, forward, centre = frame.world_T_cam[:3].T
        rotation = Rotation.from_matrix(np.stack([right, -down, -forward], axis=1))
        poses.append([*rotation.as_quat().tolist(), *centre.tolist()])  # qx qy qz qw x y z
        Image.fromarray(frame.image).save(directory / "rgb" / f"{i}.png")
        frame.depth.astype("<f4").tofile(directory / "depth" / f"{i}.bin")
    height, width = frames[0].image.shape[:2]
    K = frames[0].K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    document = {"w": width, "h": height, "dw": width, "dh": height, "fps": 60,
                "K": K.T.ravel().tolist(), "poses": poses}  # fmt: skip
    (directory / "metadata.json").write_text(json.dumps(document))
    return directory
