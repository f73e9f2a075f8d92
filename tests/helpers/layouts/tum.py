"""rgb/, depth/, rgb.txt, depth.txt, groundtruth.txt of the TUM RGB-D benchmark; K.txt."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings()  # the format says where down is
START = 1305031102.175304
COMMENTS = "# color images\n# file: 'rgbd_dataset.bag'\n# timestamp filename\n"


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open: 30 images a second, 100 poses a second."""
    (directory / "rgb").mkdir(parents=True)
    (directory / "depth").mkdir()
    np.savetxt(directory / "K.txt", frames[0].K, fmt="%.17g")
    lines: dict[str, list[str]] = {"rgb": [], "depth": [], "groundtruth": []}
    for i, frame in enumerate(frames):
        time = START + i / 30
        color, depth = f"rgb/{time:.6f}.png", f"depth/{time + 0.012:.6f}.png"
        Image.fromarray(frame.image).save(directory / color)
        units = np.round(frame.depth * 5000).astype(np.uint16)
        Image.fromarray(units).save(directory / depth)
        lines["rgb"].append(f"{time:.6f} {color}")
        lines["depth"].append(f"{time + 0.012:.6f} {depth}")
        for gap in (-0.007, 0.003, 0.013):  # the nearest is the frame's, the others are not
            pose = frame.world_T_cam
            shift = 0 if gap == 0.003 else 1
            values = [*(pose[:3, 3] + shift), *Rotation.from_matrix(pose[:3, :3]).as_quat()]
            numbers = " ".join(f"{value:.9f}" for value in values)
            lines["groundtruth"].append(f"{time + gap:.4f} {numbers}")
    for name, text in lines.items():
        (directory / f"{name}.txt").write_text(COMMENTS + "\n".join(text) + "\n")
    return directory
