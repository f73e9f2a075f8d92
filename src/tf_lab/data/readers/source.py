"""What the readers share: frames as a source gives them, and the capture made of them."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from tf_lab.data.capture import read_depth, read_image
from tf_lab.data.lens import Camera, camera_of, rectify_image, register_depth
from tf_lab.errors import TFLabError
from tf_lab.geometry import is_valid_pose

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
MAX_TEXT = 64 * 2**20  # bytes; pose and camera files are far smaller


class Pixels(Protocol):
    """Where an image or depth map comes from: called, it is read; as text, it names the file."""

    def __call__(self) -> np.ndarray:
        """The pixels. Raises TFLabError, naming the file."""
        ...


@dataclass(frozen=True)
class ColorFile:
    """uint8 [H, W, 3] of an image file."""

    path: Path

    def __call__(self) -> np.ndarray:
        """Read it."""
        return read_image(self.path)

    def __str__(self) -> str:
        return str(self.path)


@dataclass(frozen=True)
class DepthFile:
    """float32 [H, W] metres of a 16-bit depth PNG with ``scale`` units a metre."""

    path: Path
    scale: float = 1000.0

    def __call__(self) -> np.ndarray:
        """Read it."""
        return read_depth(self.path, self.scale)

    def __str__(self) -> str:
        return str(self.path)


@dataclass(frozen=True)
class SourceFrame:
    """One frame as a reader finds it.

    Attributes:
        name: unique in the capture, usable as a file name.
        camera: of the colour image.
        world_T_cam: [4, 4] in the source's world; may be invalid (frame lost).
        color: uint8 [H, W, 3] of ``camera.size``.
        depth: float32 [h, w], camera z in metres, 0 unknown; None without depth.
        depth_camera: None: depth sees what the colour image shows, at its own resolution.
        color_T_depth: [4, 4] from the depth camera to the colour camera; None: at one place.
    """

    name: str
    camera: Camera
    world_T_cam: np.ndarray
    color: Pixels
    depth: Pixels | None = None
    depth_camera: Camera | None = None
    color_T_depth: np.ndarray | None = None


@dataclass
class SourceCapture:
    """A `Capture` of a source's frames, as pinhole images of one size.

    Readers give it in the source's world; `open_capture` turns it z-up and metric.

    Attributes:
        source: the frames with a usable pose.
        cameras: what their images become.
        down: the direction of gravity [3] in the source's world, where its format states it.
        metric: whether the poses are in metres; False: the scale is unknown.

    The other attributes are those of `Capture`.
    """

    name: str
    size: tuple[int, int]
    frames: list[str]
    source: list[SourceFrame]
    cameras: list[Camera]
    K: np.ndarray
    world_T_cam: np.ndarray
    skipped: list[str]
    down: Sequence[float] | None = None
    metric: bool = True
    source_T_world: np.ndarray = field(default_factory=lambda: np.eye(4))

    def __len__(self) -> int:
        return len(self.source)

    def image(self, index: int) -> np.ndarray:
        """uint8 [H, W, 3] RGB, undistorted. Raises TFLabError if unreadable or of a wrong size."""
        frame = self.source[index]
        pixels = frame.color()
        width, height = frame.camera.size
        if pixels.shape[:2] != (height, width):
            raise TFLabError(
                f"{frame.color}: is {pixels.shape[1]}x{pixels.shape[0]}, its camera {width}x"
                f"{height}; bring all images to one size (and the intrinsics with them)"
            )
        return rectify_image(pixels, frame.camera, self.cameras[index])

    def depth(self, index: int) -> np.ndarray | None:
        """float32 [H, W] camera z in metres, of the colour image's pixels; None without depth."""
        frame = self.source[index]
        if frame.depth is None:
            return None
        depth = frame.depth()
        size = (depth.shape[1], depth.shape[0])
        camera = frame.depth_camera or frame.camera.resized(size)
        if camera.size != size:
            raise TFLabError(
                f"{frame.depth}: is {size[0]}x{size[1]}, its camera "
                f"{camera.size[0]}x{camera.size[1]}"
            )
        return register_depth(depth, camera, self.cameras[index], frame.color_T_depth)


def collect(
    source: Path,
    frames: Iterable[SourceFrame],
    skipped: Sequence[str],
    down: Sequence[float] | None = None,
    metric: bool = True,
) -> SourceCapture:
    """The capture of the frames with a usable pose; the others join ``skipped`` with a reason.

    Frames of another size than most are resized.

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
            f"{source}: no usable frame{found and ' (' + found + ')'}; "
            "every frame needs a colour image and a rigid camera-to-world pose"
        )
    size = Counter(frame.camera.size for frame in kept).most_common(1)[0][0]
    pinholes = {camera: _pinhole(source, camera, size) for camera in {f.camera for f in kept}}
    cameras = [pinholes[frame.camera] for frame in kept]
    return SourceCapture(
        name=source.resolve().name if source.is_dir() else source.stem,
        size=size,
        frames=[frame.name for frame in kept],
        source=kept,
        cameras=cameras,
        K=np.stack([camera.K for camera in cameras]),
        world_T_cam=np.stack([frame.world_T_cam for frame in kept]),
        skipped=left_out,
        down=down,
        metric=metric,
    )


def _pinhole(source: Path, camera: Camera, size: tuple[int, int]) -> Camera:
    try:
        return camera.pinhole(size)
    except TFLabError as error:
        raise TFLabError(f"{source}: {error}") from error


def read_text(path: Path, cure: str) -> str:
    """A text file.

    Raises:
        TFLabError: missing, not text or absurdly large; the message ends with the cure.
    """
    try:
        if path.stat().st_size > MAX_TEXT:
            raise TFLabError(f"{path}: too large to be this file; {cure}")
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise TFLabError(f"{path}: missing; {cure}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise TFLabError(f"{path}: cannot be read as text ({error}); {cure}") from error


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


def pose_of_quaternion(
    quaternion_wxyz: Sequence[float], translation: Sequence[float]
) -> np.ndarray:
    """A rigid transform [4, 4] from a quaternion (w, x, y, z) of any length and a translation.

    Raises:
        ValueError: the quaternion has no length, or a number is NaN or infinite.
    """
    numbers = np.array([*quaternion_wxyz, *translation], np.float64)
    if not np.isfinite(numbers).all():
        raise ValueError("NaN or infinity in the pose (frame lost)")
    w, x, y, z = numbers[:4] / (np.abs(numbers[:4]).max() or 1.0)  # squares of any size are finite
    if math.hypot(w, x, y, z) == 0:
        raise ValueError("a quaternion of zeros is no rotation")
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    pose[:3, 3] = numbers[4:]
    return pose


def opencv_of_opengl(world_T_cam: np.ndarray) -> np.ndarray:
    """A pose [4, 4] of a camera with x right, y up, z back, for one with x right, y down, z front.

    The camera stays where it is; ARKit, Blender, NeRF and nerfstudio have OpenGL's axes.
    """
    return world_T_cam @ np.diag([1.0, -1.0, -1.0, 1.0])


def read_intrinsics(path: Path, size: tuple[int, int]) -> Camera:
    """A text file of 3x3 numbers as the camera of images of (width, height) ``size``.

    Raises:
        TFLabError: the file is missing, or this is not the K of such images.
    """
    cure = "it holds the 3x3 intrinsics of the colour images in pixels: fx 0 cx / 0 fy cy / 0 0 1"
    try:
        values = [float(word) for word in read_text(path, cure).split()]
    except ValueError as error:
        raise TFLabError(f"{path}: not numbers ({error}); {cure}") from error
    if len(values) != 9:
        raise TFLabError(f"{path}: {len(values)} values instead of 9; {cure}")
    try:
        return camera_of(np.array(values).reshape(3, 3), size)
    except TFLabError as error:
        raise TFLabError(f"{path}: {error}; {cure}") from error


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
        except Exception:  # damaged data makes Pillow raise nearly anything
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
