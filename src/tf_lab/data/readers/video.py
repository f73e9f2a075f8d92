"""A video with poses of one's own: what `plain` is for images.

::

    ANY.mp4         or .mov .m4v .avi .mkv .webm; the file itself may be opened, too
    poses.txt       one line a frame: camera to world, 4x4 (16 numbers) or 3x4 (12), row by row
    K.txt           3x3 intrinsics of the frames, pixels

A video that a phone stored lying is turned upright by its metadata, as players and ffmpeg do it:
poses and K belong to the frames as one sees them.
"""

from __future__ import annotations

from pathlib import Path

from tf_lab.data.readers.frames_of_video import VIDEO_SUFFIXES, Video, VideoFrame
from tf_lab.data.readers.parsing import read_intrinsics, read_poses
from tf_lab.data.readers.source import SourceCapture, SourceFrame, collect
from tf_lab.errors import TFLabError

NAME = "video"
LAYOUT = "a video, poses.txt, K.txt"


def detect(path: Path) -> bool:
    """Whether it is a video, or a folder with one video and poses, and no images (`plain`)."""
    if path.is_file():
        return path.suffix.lower() in VIDEO_SUFFIXES
    posed = (path / "poses.txt").is_file() and not (path / "images").is_dir()
    return posed and len(video_files(path)) == 1


def read(path: Path) -> SourceCapture:
    """The capture in its own world frame.

    Raises:
        TFLabError: a part is missing or damaged, or frames and poses don't match.
    """
    videos = video_files(path) if path.is_dir() else [path]
    if len(videos) != 1:
        raise TFLabError(
            f"{path}: {len(videos)} videos ({', '.join(VIDEO_SUFFIXES)}) in it; give the folder of "
            "one video, or the file itself"
        )
    video, folder = Video(videos[0]), videos[0].parent
    poses = read_poses(folder / "poses.txt", f"{LAYOUT} belong together")
    count = video.count(len(poses))
    if count != len(poses):
        frames = f"more than {len(poses)}" if count > len(poses) else str(count)
        raise TFLabError(
            f"{video.path}: {frames} frames can be decoded, poses.txt has {len(poses)} lines; "
            "write one pose a frame (nan for a lost or unused frame)"
        )
    camera = read_intrinsics(folder / "K.txt", video.size)
    frames_of_poses = [
        SourceFrame(f"{index:06d}", camera, pose, VideoFrame(video, index))
        for index, pose in enumerate(poses)
    ]
    return collect(path, frames_of_poses, skipped=[])


def video_files(folder: Path) -> list[Path]:
    """The visible video files of a folder."""
    files = folder.iterdir() if folder.is_dir() else ()
    return [
        file
        for file in files
        if file.suffix.lower() in VIDEO_SUFFIXES and file.is_file() and file.name[0] != "."
    ]
