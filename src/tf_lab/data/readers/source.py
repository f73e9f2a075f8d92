"""What the readers share: frames as a source gives them, and the capture made of them."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import torch

from tf_lab.data.capture import read_depth, read_image
from tf_lab.data.lens import Camera, rectify_image, register_depth
from tf_lab.data.readers.scaled_rotations import unscaled
from tf_lab.data.reading import OURS, Convention
from tf_lab.errors import TFLabError
from tf_lab.geometry import is_valid_pose

MAX_DISTANCE = 1e8  # units of the source; geocentric coordinates in metres are smaller
STRAY = 100  # units of the source, and times as far off as three in four of the cameras

logger = logging.getLogger(__name__)


class Pixels(Protocol):
    """Where an image or depth map comes from: called, it is read; as text, it names the file."""

    def __call__(self) -> np.ndarray:
        """The pixels. Raises TFLabError, naming the file."""
        ...


@dataclass(frozen=True)
class ColorFile:
    """uint8 [H, W, 3] of an image file, turned if EXIF data says so and ``size`` needs it."""

    path: Path
    size: tuple[int, int] | None = None

    def __call__(self) -> np.ndarray:
        """Read it."""
        return read_image(self.path, self.size)

    def __str__(self) -> str:
        return str(self.path)


@dataclass(frozen=True)
class DepthFile:
    """float32 [H, W] metres of a depth map with ``scale`` units a metre (see `read_depth`)."""

    path: Path
    scale: float | None = None

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
        depth_camera: None: depth sees what ``depth_view`` does, at its own resolution.
        color_T_depth: [4, 4] from the depth camera to the colour camera; None: at one place.
        depth_view: None: ``camera``.
        stated: the camera that the source states, of images of another size; None: ``camera``.
    """

    name: str
    camera: Camera
    world_T_cam: np.ndarray
    color: Pixels
    depth: Pixels | None = None
    depth_camera: Camera | None = None
    color_T_depth: np.ndarray | None = None
    depth_view: Camera | None = None
    stated: Camera | None = None


@dataclass(frozen=True)
class Given:
    """What a reader found, before anything is left out.

    Attributes:
        source: the file or folder.
        frames: all that have an image, lost ones, too.
        skipped: "frame: reason" of every other frame.
        down: the direction of gravity [3] in the source's world, where its format states it.
        metric: whether the poses are in metres; False: the scale is unknown.
        convention: how the layout writes poses.
        beside: files outside of the source, other than images, that it was read from.
    """

    source: Path
    frames: Sequence[SourceFrame]
    skipped: Sequence[str]
    down: Sequence[float] | None = None
    metric: bool = True
    convention: Convention = OURS
    beside: Sequence[Path] = ()


@dataclass(frozen=True)
class Rig:
    """A colour and a depth camera mounted together, as the poses of the depth camera are given.

    Attributes:
        color: the colour camera.
        depth: the depth camera; None: depth sees what the colour image shows.
        color_T_depth: [4, 4] from the depth camera to the colour camera; None: at one place.
    """

    color: Camera
    depth: Camera | None = None
    color_T_depth: np.ndarray | None = None

    def frame(
        self, name: str, world_T_depth: np.ndarray, color: Pixels, depth: Pixels | None
    ) -> SourceFrame:
        """A frame by the pose [4, 4] of the depth camera (not finite: lost)."""
        pose = world_T_depth
        if self.color_T_depth is not None and np.isfinite(pose).all():
            pose = pose @ np.linalg.inv(self.color_T_depth)
        if depth is None:
            return SourceFrame(name, self.color, pose, color)
        return SourceFrame(name, self.color, pose, color, depth, self.depth, self.color_T_depth)


@dataclass
class SourceCapture:
    """A `Capture` of a source's frames, as pinhole images of one size.

    Readers give it in the source's world; `open_capture` turns it z-up and metric.

    Attributes:
        source: the frames with a usable pose.
        cameras: what their images become.
        given: what it is made of.

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
    given: Given
    source_T_world: np.ndarray = field(default_factory=lambda: np.eye(4))

    def __len__(self) -> int:
        return len(self.source)

    @property
    def down(self) -> Sequence[float] | None:
        """The direction of gravity [3] in the source's world, where its format states it."""
        return self.given.down

    @property
    def metric(self) -> bool:
        """Whether the source's poses are in metres; False: the scale is unknown."""
        return self.given.metric

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
        seen = frame.depth_camera or frame.depth_view or frame.camera
        shape = seen.size
        if frame.depth_camera is not None and shape != size:
            raise TFLabError(f"{frame.depth}: is {_by(size)}, its camera {_by(shape)}")
        if abs(size[0] * shape[1] - size[1] * shape[0]) > max(shape):  # rounding to whole pixels
            raise TFLabError(
                f"{frame.depth}: is {_by(size)}, its image {_by(shape)}, of another shape; turn or "
                "crop it as the image is"
            )
        camera = seen.resized(size)
        return register_depth(depth, camera, self.cameras[index], frame.color_T_depth)


def collect(
    source: Path,
    frames: Iterable[SourceFrame],
    skipped: Sequence[str],
    down: Sequence[float] | None = None,
    metric: bool = True,
    convention: Convention = OURS,
    beside: Sequence[Path] = (),
) -> SourceCapture:
    """The capture of what a reader found (see `Given` and `usable`).

    Rotations that are all scaled by one factor, as Blender and instant-ngp write those of scaled
    cameras, lose it, and the log says so.
    """
    sized = _unscaled(source, [_sized(frame) for frame in frames])
    given = Given(source, sized, skipped, down, metric, convention, beside)
    return usable(given, centred=False)  # intrinsics may still be mended


def usable(given: Given, centred: bool = True) -> SourceCapture:
    """The capture of the frames with a usable pose; the others join ``skipped`` with a reason.

    Frames of another size than most are resized.

    Args:
        given: what a reader found.
        centred: frames whose principal point lies outside of the image are left out, too.

    Raises:
        TFLabError: no frame is usable.
    """
    source = given.source
    kept, left_out = [], list(given.skipped)
    for frame in given.frames:
        reason = _why_unusable(frame, centred)
        if reason is None:
            kept.append(frame)
        else:
            left_out.append(f"{frame.name}: {reason}")
    if not kept:
        found = f"all {len(left_out)} were left out, the first: {left_out[0]}" if left_out else ""
        raise TFLabError(
            f"{source}: no usable frame{found and ' (' + found + ')'}; "
            "every frame needs a colour image and a rigid camera-to-world pose"
        )
    strays = _strays(kept)
    left_out += strays.values()
    kept = [frame for i, frame in enumerate(kept) if i not in strays]
    size = Counter(frame.camera.size for frame in kept).most_common(1)[0][0]
    pinholes, senseless = _pinholes({frame.camera for frame in kept}, size)
    left_out += [f"{f.name}: {senseless[f.camera]}" for f in kept if f.camera in senseless]
    kept = [frame for frame in kept if frame.camera in pinholes]
    if not kept:
        raise TFLabError(f"{source}: {next(iter(senseless.values()))}")
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
        given=given,
    )


def _why_unusable(frame: SourceFrame, centred: bool) -> str | None:
    """Why a frame must be left out; None: it need not."""
    if not np.isfinite(frame.world_T_cam).all():
        return "the pose has NaN or infinity (frame lost)"
    if not is_valid_pose(torch.from_numpy(frame.world_T_cam)):
        return f"the pose is not a rigid transform{_what_else(frame.world_T_cam)}"
    if np.abs(frame.world_T_cam[:3, 3]).max() > MAX_DISTANCE:
        return "the camera is impossibly far from the origin"
    for name, camera in (("", frame.camera), ("depth: ", frame.depth_camera)):
        if centred and camera is not None and not camera.centred:
            return (
                f"{name}the principal point ({camera.cx:g}, {camera.cy:g}) lies outside the "
                f"{camera.size[0]}x{camera.size[1]} images; intrinsics and images must be of one "
                "size, or intrinsics_size=[WIDTH,HEIGHT] says which images they are of"
            )
    return None


def _strays(frames: Sequence[SourceFrame]) -> dict[int, str]:
    """Frames, by index, whose camera is so far from the others that its tracker was lost."""
    centers = np.stack([frame.world_T_cam[:3, 3] for frame in frames])
    away = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
    limit = STRAY * max(1.0, np.quantile(away, 0.75))
    return {
        i: f"{frame.name}: the camera is {away[i]:.4g} off the others (tracking lost?)"
        for i, frame in enumerate(frames)
        if away[i] > limit
    }


def _what_else(pose: np.ndarray) -> str:
    """What a matrix [4, 4] that is no pose is, where that can be told."""
    mirrored = pose * np.array([-1.0, 1.0, 1.0, 1.0])
    if is_valid_pose(torch.from_numpy(np.ascontiguousarray(pose.T))):
        return " (but it is one column by column: transpose the matrices)"
    if is_valid_pose(torch.from_numpy(mirrored)):
        return " (an axis is mirrored, as by a left-handed world)"
    return ""


def _by(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def _sized(frame: SourceFrame) -> SourceFrame:
    """The frame, its image file knowing the size that the camera says."""
    if not isinstance(frame.color, ColorFile):
        return frame
    return replace(frame, color=replace(frame.color, size=frame.camera.size))


def _unscaled(source: Path, frames: Sequence[SourceFrame]) -> list[SourceFrame]:
    """The frames without the factor that their rotations are scaled by."""
    if not frames:
        return []
    poses, factor = unscaled(np.stack([frame.world_T_cam for frame in frames]))
    if factor != 1:
        logger.warning("%s: the rotations of its poses are scaled by %.4g; the scale is taken out, "
                       "positions stay", source, factor)  # fmt: skip
    return [replace(f, world_T_cam=pose) for f, pose in zip(frames, poses, strict=True)]


def _pinholes(
    cameras: Iterable[Camera], size: tuple[int, int]
) -> tuple[dict[Camera, Camera], dict[Camera, TFLabError]]:
    """Cameras without distortion, and why some cannot be."""
    found, senseless = {}, {}
    for camera in cameras:
        try:
            found[camera] = camera.pinhole(size)
        except TFLabError as error:
            senseless[camera] = error
    return found, senseless
