"""An ARKit recording of the app ios_logger, as NeuralRecon's demo uses it.

::

    Frames.m4v      the camera's images as the sensor has them (lying); or images/ of all of them
    Frames.txt      "timestamp,frame,fx,fy,cx,cy" a line: seconds, frame of the video from 0, pixels
    ARposes.txt     "timestamp,tx,ty,tz,qw,qx,qy,qz" a line: camera to world, metres

Both texts carry the timestamps of ARKit's frames; a frame takes the pose of the nearest, at most
0.02 s away. Cameras and world are ARKit's (see `apps`), of the images as stored, however the phone
is held; the video's orientation is ignored.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tf_lab.data.lens import Camera
from tf_lab.data.readers.apps import DOWN, arkit_camera
from tf_lab.data.readers.frames_of_video import Video, VideoFrame
from tf_lab.data.readers.images import image_files, image_size
from tf_lab.data.readers.parsing import (
    MAX_GAP,
    Timeline,
    opencv_of_opengl,
    pose_of_quaternion,
    read_timeline,
)
from tf_lab.data.readers.source import ColorFile, Pixels, SourceCapture, SourceFrame, collect
from tf_lab.data.reading import Convention
from tf_lab.errors import TFLabError

NAME = "arkit"
LAYOUT = "Frames.txt, ARposes.txt, Frames.m4v or images/"
CONVENTION = Convention(axes="opengl", quaternions="wxyz")


def detect(directory: Path) -> bool:
    """Whether the two lists are there."""
    return all((directory / name).is_file() for name in ("Frames.txt", "ARposes.txt"))


def read(directory: Path) -> SourceCapture:
    """The recording in ARKit's world.

    Raises:
        TFLabError: a part is missing or damaged, or no frame is usable.
    """
    lines = read_timeline(directory / "Frames.txt", "frame fx fy cx cy", ",")
    poses = read_timeline(directory / "ARposes.txt", "tx ty tz qw qx qy qz", ",")
    size, images = _images(directory, lines)
    frames, skipped = [], []
    left = dict(enumerate(images))
    for time, words in zip(lines.times, lines.values, strict=True):
        try:
            color = left.pop(int(words[0]), None)
            if color is None:
                raise ValueError(f"a second time, or not one of the {len(images)} images")
            camera = _camera(words[1:], size)
            pose = _pose(poses, time)
        except (ValueError, TFLabError) as error:
            skipped.append(f"frame {words[0][:20]}: {error}")
            continue
        frames.append(SourceFrame(f"{int(words[0]):06d}", camera, pose, color))
    return collect(directory, frames, skipped, DOWN, convention=CONVENTION)


def _images(directory: Path, lines: Timeline) -> tuple[tuple[int, int], Sequence[Pixels]]:
    """The size of the images and where they are, by the frame's number."""
    file, folder = directory / "Frames.m4v", directory / "images"
    if file.is_file():
        video = Video(file, upright=False)
        numbers = (int(n) for n, *_ in lines.values if n.isdecimal() and len(n) < 10)
        count = video.count(1 + max(numbers, default=-1))
        return video.size, [VideoFrame(video, index) for index in range(count)]
    files = image_files(folder) if folder.is_dir() else []
    if len(files) != len(lines.times):
        raise TFLabError(
            f"{directory}: no Frames.m4v, and images/ has {len(files)} images for the "
            f"{len(lines.times)} lines of Frames.txt; copy the video from the phone, or extract "
            "all of its frames"
        )
    return image_size(files), [ColorFile(path) for path in files]


def _camera(words: Sequence[str], size: tuple[int, int]) -> Camera:
    fx, fy, cx, cy = (float(word) for word in words)
    return arkit_camera(size, fx, fy, cx, cy)


def _pose(poses: Timeline, time: float) -> np.ndarray:
    words = poses.nearest(time)
    if words is None:
        raise ValueError(f"no pose within {MAX_GAP} s")
    tx, ty, tz, qw, qx, qy, qz = (float(word) for word in words)
    return opencv_of_opengl(pose_of_quaternion((qw, qx, qy, qz), (tx, ty, tz)))
