"""What the readers share: a capture whose images are files, and the checks on what is read."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from tf_lab.data.capture import read_depth, read_image
from tf_lab.errors import TFLabError
from tf_lab.geometry import is_valid_pose

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")


@dataclass
class FolderCapture:
    """A `Capture` of image files. Readers give it in the source's frame, `upright` turns it z-up.

    Attributes:
        colors: the colour file of every frame.
        depths: the depth file of every frame, None where it has none.
        depth_scale: units of the depth files per metre.

    The other attributes are those of `Capture`.
    """

    name: str
    size: tuple[int, int]
    frames: list[str]
    K: np.ndarray
    world_T_cam: np.ndarray
    skipped: list[str]
    colors: list[Path]
    depths: list[Path | None]
    depth_scale: float = 1000.0
    source_R_world: np.ndarray = field(default_factory=lambda: np.eye(3))

    def __len__(self) -> int:
        return len(self.frames)

    def image(self, index: int) -> np.ndarray:
        """uint8 [H, W, 3] RGB. Raises TFLabError if unreadable or not of the capture's size."""
        return self._checked(read_image(self.colors[index]), self.colors[index])

    def depth(self, index: int) -> np.ndarray | None:
        """float32 [H, W] camera z in metres, 0 where unknown; None without a depth file."""
        path = self.depths[index]
        return None if path is None else self._checked(read_depth(path, self.depth_scale), path)

    def _checked(self, pixels: np.ndarray, path: Path) -> np.ndarray:
        height, width = pixels.shape[:2]
        if (width, height) != self.size:
            raise TFLabError(
                f"{path}: is {width}x{height}, the capture is {self.size[0]}x{self.size[1]}; "
                "bring all images and depth maps to one size (and the intrinsics with them)"
            )
        return pixels


@dataclass(frozen=True)
class FrameFiles:
    """One frame as a reader finds it: K [3, 3], world_T_cam [4, 4] (maybe invalid), its files."""

    name: str
    color: Path
    K: np.ndarray
    world_T_cam: np.ndarray
    depth: Path | None = None


def collect(
    directory: Path, size: tuple[int, int], frames: Iterable[FrameFiles], skipped: Sequence[str]
) -> FolderCapture:
    """The capture of the frames with a usable pose; the others join ``skipped`` with a reason.

    Raises:
        TFLabError: no frame is usable.
    """
    kept, left_out = [], list(skipped)
    for frame in frames:
        if not np.isfinite(frame.world_T_cam).all():
            left_out.append(f"{frame.name}: the pose has NaN or infinity (frame lost)")
        elif not is_valid_pose(torch.from_numpy(frame.world_T_cam)):
            left_out.append(f"{frame.name}: the pose is not a rigid transform")
        else:
            kept.append(frame)
    if not kept:
        found = f"all {len(left_out)} were left out, the first: {left_out[0]}" if left_out else ""
        raise TFLabError(
            f"{directory}: no usable frame{found and ' (' + found + ')'}; "
            "every frame needs a colour image and a rigid camera-to-world pose"
        )
    return FolderCapture(
        name=directory.resolve().name,
        size=size,
        frames=[frame.name for frame in kept],
        K=np.stack([frame.K for frame in kept]),
        world_T_cam=np.stack([frame.world_T_cam for frame in kept]),
        skipped=left_out,
        colors=[frame.color for frame in kept],
        depths=[frame.depth for frame in kept],
    )


def parse_pose(text: str) -> np.ndarray:
    """A pose [4, 4] from 16 numbers, or from the 12 of its upper three rows, row by row.

    NaN and infinity are numbers here: sources mark lost frames with them.

    Raises:
        ValueError: it is something else; the message says what.
    """
    words = text.split()
    if len(words) not in (12, 16):
        raise ValueError(f"{len(words)} values, a pose has 16 (4x4) or 12 (3x4)")
    pose = np.eye(4)
    pose.flat[: len(words)] = [float(word) for word in words]
    return pose


def read_intrinsics(path: Path, size: tuple[int, int]) -> np.ndarray:
    """A text file of 3x3 numbers as K [3, 3], checked to fit images of (width, height) ``size``.

    Raises:
        TFLabError: the file is missing, or this is not the K of such images.
    """
    cure = "it holds the 3x3 intrinsics of the colour images in pixels: fx 0 cx / 0 fy cy / 0 0 1"
    try:
        values = [float(word) for word in path.read_text().split()]
    except FileNotFoundError as error:
        raise TFLabError(f"{path}: missing; {cure}") from error
    except ValueError as error:  # includes bytes that are not text
        raise TFLabError(f"{path}: not numbers ({error}); {cure}") from error
    if len(values) != 9:
        raise TFLabError(f"{path}: {len(values)} values instead of 9; {cure}")
    K = np.array(values).reshape(3, 3)
    shaped = np.isfinite(K).all() and np.allclose(K[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1])
    if not shaped or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise TFLabError(f"{path}: not a camera matrix (fx, fy must be positive); {cure}")
    if not (0 <= K[0, 2] < size[0] and 0 <= K[1, 2] < size[1]):
        raise TFLabError(
            f"{path}: the principal point ({K[0, 2]:g}, {K[1, 2]:g}) lies outside the "
            f"{size[0]}x{size[1]} images; scale K to their size"
        )
    return K


def image_size(paths: Iterable[Path]) -> tuple[int, int]:
    """(width, height) by the first header that can be read; nothing is decoded.

    Raises:
        TFLabError: none can be read.
    """
    last = None
    for last in paths:
        try:
            with Image.open(last) as image:
                return image.size
        except OSError:
            continue  # the capture reports this file when its image is asked for
    raise TFLabError(f"{last}: not one of the colour images can be read; use JPEG or PNG")


def image_files(directory: Path) -> list[Path]:
    """The visible JPEG and PNG files of a directory, in natural order (img2 before img10)."""
    files = (path for path in directory.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    return sorted((path for path in files if not path.name.startswith(".")), key=_natural)


def _natural(path: Path) -> tuple[list[tuple[str, int]], str]:
    # alternating text and digits: every part compares as (text, number)
    parts = re.findall(r"(\D*)(\d*)", path.stem)
    return [(text.lower(), int(digits or -1)) for text, digits in parts], path.name
