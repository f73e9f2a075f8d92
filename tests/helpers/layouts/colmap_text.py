"""images/ and sparse/0/*.txt of COLMAP, its unit 2.5 m: cam_T_world, pixel centres at 0.5."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

UNIT = 2.5  # metres
OPTIONS = ReadSettings(gravity=(0, 0, -1), scale=UNIT)


def cam_T_world(frame: Frame) -> tuple[list[float], list[float]]:
    """The quaternion (w, x, y, z) and the translation, in COLMAP's unit."""
    world_R_cam, centre = frame.world_T_cam[:3, :3], frame.world_T_cam[:3, 3] / UNIT
    x, y, z, w = Rotation.from_matrix(world_R_cam.T).as_quat().tolist()
    return [w, x, y, z], (-world_R_cam.T @ centre).tolist()


def write_images(directory: Path, frames: Sequence[Frame]) -> list[str]:
    """The images, and their names."""
    (directory / "images").mkdir(parents=True)
    names = [f"view {i}.png" for i in range(len(frames))]
    for name, frame in zip(names, frames, strict=True):
        Image.fromarray(frame.image).save(directory / "images" / name)
    return names


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    names = write_images(directory, frames)
    model = directory / "sparse" / "0"
    model.mkdir(parents=True)
    (fx, _, cx), (_, fy, cy), _ = frames[0].K.tolist()
    height, width = frames[0].image.shape[:2]
    (model / "cameras.txt").write_text(
        "# Camera list with one line of data per camera:\n"
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        f"3 PINHOLE {width} {height} {fx!r} {fy!r} {cx + 0.5!r} {cy + 0.5!r}\n"
    )
    lines = ["# Image list with two lines of data per image:", "#   POINTS2D[] as (X, Y, ID)"]
    for i in np.random.default_rng(0).permutation(len(frames)):  # ids and lines have no order
        quaternion, translation = cam_T_world(frames[i])
        numbers = " ".join(repr(value) for value in quaternion + translation)
        lines.append(f"{100 - i} {numbers} 3 {names[i]}")
        lines.append("" if i % 3 == 0 else "10.5 20.25 7 11.5 3.0 -1")
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    (model / "points3D.txt").write_text("7 0.5 0.5 0.5 1 2 3 0.5 100 0\n")
    return directory
