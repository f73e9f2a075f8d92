"""The layout to write when one has poses of one's own and no format yet.

::

    images/         JPEG or PNG, in natural order of their names
    poses.txt       one line an image: camera to world, 4x4 (16 numbers) or 3x4 (12), row by row
    K.txt           3x3 intrinsics of the images, pixels
    depth/          of the same stems, 0 = no reading (optional): PNG or TIFF of 16-bit millimetres,
                    or TIFF or .npy of floating-point metres
"""

from __future__ import annotations

from pathlib import Path

from tf_lab.data.readers.images import image_files, match_depths
from tf_lab.data.readers.parsing import read_camera, read_poses
from tf_lab.data.readers.source import ColorFile, DepthFile, SourceCapture, SourceFrame, collect
from tf_lab.errors import TFLabError

NAME = "plain"
LAYOUT = "images/, poses.txt, K.txt"


def detect(directory: Path) -> bool:
    """Whether images and poses lie where this layout has them."""
    return (directory / "images").is_dir() and (directory / "poses.txt").is_file()


def read(directory: Path) -> SourceCapture:
    """The capture in its own world frame.

    Raises:
        TFLabError: a part is missing or damaged, or images and poses don't match.
    """
    folder = directory / "images"
    images = image_files(folder) if folder.is_dir() else []
    if not images:
        raise TFLabError(f"{folder}: no JPEG or PNG image in it; put the colour images there")
    poses = read_poses(directory / "poses.txt", f"{LAYOUT} belong together")
    if len(poses) != len(images):
        raise TFLabError(
            f"{directory}: poses.txt has {len(poses)} lines, images/ has {len(images)} images; "
            "write one pose an image (nan for a lost frame), in the order of the images' names"
        )
    stems = [path.stem for path in images]
    if len(set(stems)) < len(stems):
        twice = next(stem for stem in stems if stems.count(stem) > 1)
        raise TFLabError(f"{folder}: two images are called {twice}; names must differ by stem")
    camera = read_camera(directory / "K.txt", images)
    depths = match_depths(directory / "depth", images)
    frames = [
        SourceFrame(
            image.stem,
            camera,
            pose,
            ColorFile(image),
            DepthFile(depths[image]) if image in depths else None,
        )
        for image, pose in zip(images, poses, strict=True)
    ]
    return collect(directory, frames, skipped=[])
