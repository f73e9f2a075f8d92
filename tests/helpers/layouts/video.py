"""A video, poses.txt, K.txt. The video is coded without loss, so that images can be compared."""

import struct
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings(gravity=(0, 0, -1))


def write_video(path: Path, images: Sequence[np.ndarray], codec: str = "png ") -> None:
    """RGB images as a video."""
    height, width = images[0].shape[:2]
    fourcc = cv2.VideoWriter_fourcc(*codec)  # type: ignore[attr-defined]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, fourcc, 30, (width, height))
    assert writer.isOpened()
    for image in images:
        writer.write(np.ascontiguousarray(image[:, :, ::-1]))
    writer.release()


def held_upright(content: bytes) -> bytes:
    """The mp4 file, with the mark of a phone held upright: to be turned clockwise."""
    matrix = struct.pack(">9i", 0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30)
    at = content.index(b"tkhd") + 44
    assert struct.unpack(">9i", content[at : at + 36])[:2] == (1 << 16, 0)
    return content[:at] + matrix + content[at + 36 :]


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    directory.mkdir(parents=True)
    write_video(directory / "walk.mov", [frame.image for frame in frames])
    poses = np.stack([frame.world_T_cam.reshape(16) for frame in frames])
    np.savetxt(directory / "poses.txt", poses, fmt="%.17g")
    np.savetxt(directory / "K.txt", frames[0].K, fmt="%.17g")
    return directory
