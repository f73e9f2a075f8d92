"""What people get wrong, done to right captures; each with the setting that mends it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tf_lab.data.lens import camera_of
from tf_lab.data.readers import as_read
from tf_lab.data.readers.source import SourceCapture, SourceFrame, collect
from tf_lab.data.reading import Convention, ReadSettings
from tf_lab.data.scene import Frame


@dataclass(frozen=True)
class Held:
    """Pixels in memory; of depth, in units of which ``scale`` are a metre."""

    stored: np.ndarray
    scale: float = 0.0

    def __call__(self) -> np.ndarray:
        return (self.stored / self.scale).astype(np.float32) if self.scale else self.stored

    def __str__(self) -> str:
        return "an image in memory"


def source_of(frames: Sequence[Frame], quaternions: str | None = None) -> SourceCapture:
    """What a reader would give of frames."""
    found = []
    for frame in frames:
        size = (frame.image.shape[1], frame.image.shape[0])
        depth = None if frame.depth is None else Held(frame.depth * 1000, 1000.0)
        camera = camera_of(frame.K, size)
        found.append(SourceFrame(frame.name, camera, frame.world_T_cam, Held(frame.image), depth))
    return collect(Path("made up"), found, [], convention=Convention(quaternions=quaternions))


def opened(
    frames: Sequence[Frame], settings: ReadSettings, quaternions: str | None = None
) -> SourceCapture:
    """Frames as a capture; wrong intrinsics are left to the check."""
    return as_read(source_of(frames, quaternions), Path("made up"), settings, strict=False)


Frames = list[Frame]


def _posed(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Frames], Frames]:
    return lambda frames: [replace(f, world_T_cam=change(f.world_T_cam)) for f in frames]


def _transposed(pose: np.ndarray) -> np.ndarray:
    wrong = pose.copy()
    wrong[:3, :3] = pose[:3, :3].T
    return wrong


def _misread(pose: np.ndarray) -> np.ndarray:
    """(w, x, y, z) read as (x, y, z, w)."""
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    wrong = pose.copy()
    wrong[:3, :3] = Rotation.from_quat([w, x, y, z]).as_matrix()
    return wrong


def _unity(pose: np.ndarray) -> np.ndarray:
    return np.eye(4)[[0, 2, 1, 3]] @ pose @ np.diag([1.0, -1, 1, 1])


def _moved(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(pose: np.ndarray) -> np.ndarray:
        wrong = pose.copy()
        wrong[:3, 3] *= factor
        return wrong

    return change


def _focal(factor: float) -> Callable[[Frames], Frames]:
    scale = np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
    return lambda frames: [replace(f, K=f.K * scale) for f in frames]


def _halved(frames: Frames) -> Frames:
    """Images and depth of half the size, intrinsics as they were."""
    found = []
    for f in frames:
        half = (f.image.shape[1] // 2, f.image.shape[0] // 2)
        image = cv2.resize(f.image, half, interpolation=cv2.INTER_AREA)
        depth = None if f.depth is None else f.depth[::2, ::2]
        found.append(replace(f, image=image, depth=depth))
    return found


def _turned(frames: Frames) -> Frames:
    """Images turned counter-clockwise, intrinsics and poses as they were."""
    return [
        replace(
            f,
            image=np.ascontiguousarray(np.rot90(f.image)),
            depth=None if f.depth is None else np.ascontiguousarray(np.rot90(f.depth)),
        )
        for f in frames
    ]


def _shifted(frames: Frames) -> Frames:
    """Each image has the pose of the one three before it."""
    last = len(frames) - 1
    return [
        replace(f, world_T_cam=frames[min(max(i - 3, 0), last)].world_T_cam)
        for i, f in enumerate(frames)
    ]


def _deep(factor: float) -> Callable[[Frames], Frames]:
    def change(frames: Frames) -> Frames:
        return [replace(f, depth=None if f.depth is None else f.depth * factor) for f in frames]

    return change


def _size(frames: Frames) -> str:
    height, width = frames[0].image.shape[:2]
    return f"intrinsics_size=[{width},{height}]"


@dataclass(frozen=True)
class Injection:
    """A fault: what is done, and the setting that says so (a number may be 5 % off)."""

    do: Callable[[Frames], Frames]
    mend: str | Callable[[Frames], str]
    quaternions: str | None = None

    def names(self, settings: Sequence[str], right: Frames) -> bool:
        """Whether these settings, alone, are those that mend it."""
        wanted = self.mend if isinstance(self.mend, str) else self.mend(right)
        if len(settings) != 1:
            return False
        (name, value), (expected, right_value) = settings[0].split("="), wanted.split("=")
        try:
            near = abs(np.log(float(value) / float(right_value))) < 0.05
        except (ValueError, FloatingPointError):
            near = value == right_value
        return name == expected and bool(near)


INJECTIONS = {
    "inverted": Injection(_posed(np.linalg.inv), "poses=world_to_camera"),
    "opengl": Injection(_posed(lambda pose: pose @ np.diag([1.0, -1, -1, 1])), "axes=opengl"),
    "ros": Injection(_posed(lambda p: p @ np.array(
        [[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])), "axes=ros"),
    "unity": Injection(_posed(_unity), "axes=unity"),
    "transposed": Injection(_posed(_transposed), "rotations=transposed"),
    "quaternions": Injection(_posed(_misread), "quaternions=wxyz", quaternions="xyzw"),
    "focal x 0.8": Injection(_focal(0.8), "focal_scale=1.25"),
    "focal x 1.25": Injection(_focal(1.25), "focal_scale=0.8"),
    "half-size": Injection(_halved, _size),
    "turned": Injection(_turned, "turn=90"),
    "shifted": Injection(_shifted, "shift=3"),
    "scale x 0.01": Injection(_posed(_moved(0.01)), "scale=100"),
    "scale x 1000": Injection(_posed(_moved(1000.0)), "scale=0.001"),
    "depth x 5": Injection(_deep(5.0), "depth_scale=5000"),
    "depth / 10": Injection(_deep(0.1), "depth_scale=100"),
}  # fmt: skip
