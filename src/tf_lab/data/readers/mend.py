"""What a source says wrongly, put right: the mends of `ReadSettings` on the frames as read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tf_lab.data.lens import Camera
from tf_lab.data.readers.source import Given, Pixels, SourceCapture, SourceFrame, usable
from tf_lab.data.reading import AXES, Convention, ReadSettings
from tf_lab.errors import TFLabError

DIRECTIONS = {
    "r": (1, 0, 0), "d": (0, 1, 0), "f": (0, 0, 1),
    "l": (-1, 0, 0), "u": (0, -1, 0), "b": (0, 0, -1),
}  # fmt: skip
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])  # keeps "up" whether that is y or z


@dataclass(frozen=True)
class Turned:
    """Pixels of a file, turned clockwise by ``turn`` degrees."""

    pixels: Pixels
    turn: int

    def __call__(self) -> np.ndarray:
        """Read and turn them."""
        return np.ascontiguousarray(np.rot90(self.pixels(), -self.turn // 90))

    def __str__(self) -> str:
        return str(self.pixels)


def mended(capture: SourceCapture, settings: ReadSettings, centred: bool = True) -> SourceCapture:
    """The capture with the settings' mends, in its own world (a mirrored one of a left-handed).

    Raises:
        TFLabError: a mend does not fit the source, or leaves no usable frame.
    """
    given = capture.given
    if settings.quaternions is not None and given.convention.quaternions is None:
        raise TFLabError(
            f"quaternions={settings.quaternions}: {given.source} has no quaternions; leave it out"
        )
    poses = mended_poses(given, settings, range(len(given.frames)))
    frames, skipped = [], list(given.skipped)
    for index, (frame, pose) in enumerate(zip(given.frames, poses, strict=True)):
        if 0 <= index + settings.shift < len(poses):
            frames.append(_mended_frame(replace(frame, world_T_cam=pose), settings))
        else:
            skipped.append(f"{frame.name}: shift={settings.shift}: no frame is that many later")
    found = usable(replace(given, frames=frames, skipped=skipped), centred)
    return replace(found, given=given, source_T_world=world_mirror(settings))


def mended_poses(given: Given, settings: ReadSettings, indices: Iterable[int]) -> list[np.ndarray]:
    """world_T_cam [4, 4] of some frames in the source's unit; of lost ones, NaN or infinity."""
    found = []
    for index in indices:
        later = index + settings.shift
        there = 0 <= later < len(given.frames)
        pose = given.frames[later].world_T_cam if there else np.full((4, 4), np.nan)
        if np.isfinite(pose).all():
            pose = _decoded(pose, given.frames[later], given.convention, settings)
        found.append(pose)
    return found


def world_mirror(settings: ReadSettings) -> np.ndarray:
    """[4, 4] from the right-handed world to the source's, which is mirrored by left-handed axes."""
    left_handed = settings.axes is not None and np.linalg.det(axes_matrix(settings.axes)) < 0
    return MIRROR if left_handed else np.eye(4)


def axes_matrix(name: str) -> np.ndarray:
    """[3, 3], its columns where the camera's x, y, z point, in OpenCV's axes."""
    return np.array([DIRECTIONS[letter] for letter in AXES.get(name, name)], np.float64).T


def _decoded(
    pose: np.ndarray, frame: SourceFrame, native: Convention, settings: ReadSettings
) -> np.ndarray:
    """A frame's pose as a reader understood it, understood as the settings say."""
    rig = np.eye(4) if frame.color_T_depth is None else frame.color_T_depth
    pose = pose @ rig @ _homogeneous(axes_matrix(native.axes))  # poses are the depth camera's
    written = np.linalg.inv(pose) if native.poses == "world_to_camera" else pose
    written = written.copy()
    if settings.quaternions not in (None, native.quaternions):
        written[:3, :3] = _reordered(written[:3, :3], str(settings.quaternions))
    if settings.rotations == "transposed":
        written[:3, :3] = written[:3, :3].T
    inverse = (settings.poses or native.poses) == "world_to_camera"
    pose = np.linalg.inv(written) if inverse else written
    axes = axes_matrix(settings.axes or native.axes)
    rig = _turned_rig(frame, settings.turn, rig)
    return world_mirror(settings) @ pose @ _homogeneous(axes.T) @ np.linalg.inv(rig)


def _depth_turns(frame: SourceFrame) -> bool:
    """Whether depth was stored lying as colour was; if not, colour alone was turned."""
    if frame.depth_camera is None:
        return True
    (w, h), (wide, high) = frame.camera.size, frame.depth_camera.size
    return (w > h) == (wide > high)


def _turned_rig(frame: SourceFrame, turn: int, rig: np.ndarray) -> np.ndarray:
    """Where depth is beside colour [4, 4] when the images of both are turned clockwise."""
    if not turn or frame.depth_camera is None or not _depth_turns(frame):
        return rig
    plane = _homogeneous(Rotation.from_euler("z", turn, degrees=True).as_matrix())
    return plane @ rig @ plane.T


def _homogeneous(rotation: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix


def _reordered(rotation: np.ndarray, order: str) -> np.ndarray:
    """The rotation [3, 3] whose quaternion was read in the other order than ``order``."""
    read = Rotation.from_matrix(rotation).as_quat()  # x, y, z, w
    return Rotation.from_quat(np.roll(read, -1 if order == "wxyz" else 1)).as_matrix()


def _mended_frame(frame: SourceFrame, settings: ReadSettings) -> SourceFrame:
    color, depth, seen = frame.color, frame.depth, frame.depth_camera
    stored, rig = frame.camera, frame.color_T_depth
    if depth is not None and settings.depth_scale is not None:
        depth = _in_units(depth, settings.depth_scale)
    if settings.turn != 0:
        color, stored = Turned(color, settings.turn), turned(stored, settings.turn)
        if depth is not None and _depth_turns(frame):
            depth = Turned(depth, settings.turn)
            rig = None if rig is None else _turned_rig(frame, settings.turn, rig)
            seen = None if seen is None else turned(seen, settings.turn)
    camera = mended_camera(stored, settings, as_stated(frame, settings))
    if settings.depth_camera == "as_given":
        frame = replace(frame, depth_view=stored)
    return replace(
        frame, camera=camera, color=color, depth=depth, depth_camera=seen, color_T_depth=rig
    )


def as_stated(frame: SourceFrame, settings: ReadSettings) -> Camera | None:
    """The camera as the source states it, turned as the images are; None: as the frame has it."""
    return None if frame.stated is None else turned(frame.stated, settings.turn)


def mended_camera(camera: Camera, settings: ReadSettings, stated: Camera | None = None) -> Camera:
    """The camera with its size, focal length and principal point put right.

    Args:
        camera: of the images.
        settings: which say what is wrong with it.
        stated: before it was resized to the images'; None: it was not.
    """
    if settings.intrinsics_size is not None:
        written = replace(stated or camera, size=settings.intrinsics_size)
        camera = written.resized(camera.size)
    if settings.focal_scale != 1:
        factor = settings.focal_scale
        camera = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
    if settings.principal is None:
        return camera
    if isinstance(settings.principal, str):  # the centre
        width, height = camera.size
        return replace(camera, cx=(width - 1) / 2, cy=(height - 1) / 2)
    x, y = settings.principal
    return replace(camera, cx=camera.cx + float(x), cy=camera.cy + float(y))


def turned(camera: Camera, turn: int) -> Camera:
    """The camera of images turned clockwise, whose intrinsics may be of the turned ones already."""
    width, height = camera.size
    if turn in (0, 180):
        return camera  # nearly the same, and nobody knows which is meant
    size = (height, width)
    here = np.hypot(camera.cx - (width - 1) / 2, camera.cy - (height - 1) / 2)
    there = np.hypot(camera.cx - (height - 1) / 2, camera.cy - (width - 1) / 2)
    if there < here:
        return replace(camera, size=size)
    cx, cy = camera.cy, camera.cx
    lens = camera.distortion
    if turn == 90:
        cx = height - 1 - cx
    else:
        cy = width - 1 - cy
    if not camera.fisheye and len(lens) >= 4:  # the tangential part turns along
        p1, p2 = (lens[3], -lens[2]) if turn == 90 else (-lens[3], lens[2])
        lens = (*lens[:2], p1, p2, *lens[4:])
    return replace(camera, size=size, fx=camera.fy, fy=camera.fx, cx=cx, cy=cy, distortion=lens)


def _in_units(depth: Pixels, scale: float) -> Pixels:
    """Depth of ``scale`` units a metre."""
    if not is_dataclass(depth) or "scale" not in {f.name for f in fields(depth)}:
        raise TFLabError(f"depth_scale={scale:g}: {depth} has no unit that could be another")
    scaled: Any = replace(depth, scale=float(scale))
    return scaled
