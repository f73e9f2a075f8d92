"""What cameras and poses, read in some way, make of the matches: epipolar errors and depths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from tf_lab.data.capture import Capture
from tf_lab.data.diagnosis.matches import MOST, Pair, sampson_pixels
from tf_lab.data.lens import Camera, camera_of
from tf_lab.data.readers.mend import mended_camera, mended_poses, turned
from tf_lab.data.readers.source import Given, SourceCapture, SourceFrame
from tf_lab.data.reading import ReadSettings

PARALLAX = 0.02  # radians between the rays of a point whose depth is worth asking for
SMALL = 0.05  # pixels at 640 columns: differences below it mean nothing


@dataclass(frozen=True)
class Geometry:
    """Cameras of the frames that have matches, by their position in `Evidence.frames`.

    Attributes:
        K: [F, 3, 3], pixels of the images turned by ``turn`` degrees against those matched.
        world_T_cam: [F, 4, 4] in metres, as far as that is known; NaN where lost.
        size: (width, height) of the images as matched.
        turn: degrees clockwise.
    """

    K: np.ndarray
    world_T_cam: np.ndarray
    size: tuple[int, int]
    turn: int

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Pixels [..., 2] of the images as matched, as those of the turned ones."""
        (width, height), (u, v) = self.size, np.moveaxis(points, -1, 0)
        moved = {
            0: (u, v),
            90: (height - 1 - v, u),
            180: (width - 1 - u, height - 1 - v),
            270: (v, width - 1 - u),
        }
        return np.stack(moved[self.turn], axis=-1)


class Evidence:
    """The matches of a capture, ready to be held against cameras read in any way.

    Attributes:
        pairs: with matches.
        frames: which frames of the capture have some.
        settings: how the capture was read.
        given: what its reader found.
    """

    def __init__(self, capture: Capture, settings: ReadSettings, pairs: list[Pair]) -> None:
        self.capture, self.settings, self.pairs = capture, settings, pairs
        self.frames = sorted({index for pair in pairs for index in (pair.i, pair.j)})
        self.given = given_of(capture)
        self._known_poses: dict[tuple[object, ...], list[np.ndarray]] = {}
        self._numbers = {frame.name: n for n, frame in enumerate(self.given.frames)}
        places = {index: place for place, index in enumerate(self.frames)}
        self.first = np.array([places[pair.i] for pair in pairs], int)
        self.second = np.array([places[pair.j] for pair in pairs], int)
        self.a, self.b = (np.full((len(pairs), MOST, 2), np.nan) for _ in range(2))
        for row, pair in enumerate(pairs):
            self.a[row, : len(pair.a)], self.b[row, : len(pair.b)] = pair.a, pair.b

    @property
    def centred(self) -> bool:
        """Whether the principal points lie in the images, as the capture was read."""
        centres, size = self.capture.K[:, :2, 2], np.array(self.capture.size)
        return bool(((centres >= -0.5) & (centres < size)).all())

    def geometry(self, settings: ReadSettings) -> Geometry:
        """The cameras of the frames, had the capture been read with these settings."""
        posed = self.posed(settings, self.frames)
        turn = (settings.turn - self.settings.turn) % 360
        poses = np.array([pose for pose, _ in posed]).reshape(-1, 4, 4)
        K = np.array([K for _, K in posed]).reshape(-1, 3, 3)
        return Geometry(K, poses, self.capture.size, turn)

    def posed(
        self, settings: ReadSettings, frames: Sequence[int]
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """world_T_cam [4, 4] and K [3, 3] of frames of the capture, had it been read so."""
        numbers = [self._numbers[self.capture.frames[i]] for i in frames]
        turn = (settings.turn - self.settings.turn) % 360
        width, height = self.capture.size
        size = (height, width) if turn % 180 else (width, height)
        cameras: dict[tuple[Camera, Camera | None], np.ndarray] = {}
        found = []
        for number, pose in zip(numbers, self._poses(settings, numbers), strict=True):
            frame = self.given.frames[number]
            key = frame.camera, frame.stated
            if key not in cameras:
                cameras[key] = _intrinsics(frame, settings, size)
            found.append((pose, cameras[key]))
        return found

    def _poses(self, settings: ReadSettings, numbers: list[int]) -> list[np.ndarray]:
        """world_T_cam [4, 4] of the reader's frames, metres; the same for all intrinsics."""
        said = (settings.poses, settings.axes, settings.rotations, settings.quaternions)
        key = (*said, settings.shift, settings.scale, settings.turn, *numbers)
        if key not in self._known_poses:
            poses = [pose.copy() for pose in mended_poses(self.given, settings, numbers)]
            for pose in poses:
                pose[:3, 3] *= settings.scale or 1.0
            self._known_poses[key] = poses
        return self._known_poses[key]

    def errors(self, geometry: Geometry) -> np.ndarray:
        """Median Sampson distance of each pair [P], pixels; NaN without poses."""
        ordered = np.sort(self.distances(geometry), axis=1)  # NaN last
        count = np.isfinite(ordered).sum(1)
        rows = np.arange(len(ordered))
        return np.asarray(ordered[rows, count // 2 - (count > 0) * (count % 2 == 0)])

    def distances(self, geometry: Geometry) -> np.ndarray:
        """Sampson distance of every match [P, MOST], pixels; NaN where there is none."""
        with np.errstate(invalid="ignore"):
            F = self._fundamental(geometry)
            return sampson_pixels(F, geometry.pixels(self.a), geometry.pixels(self.b))

    def lines(self, geometry: Geometry, row: int) -> np.ndarray:
        """Epipolar lines (a, b, c) [M, 3] of a pair's matches in its second image, as matched."""
        points = np.concatenate([self.pairs[row].a, np.ones((len(self.pairs[row].a), 1))], axis=1)
        return np.asarray(points @ self._fundamental(geometry)[row].T)

    def _fundamental(self, geometry: Geometry) -> np.ndarray:
        """F [P, 3, 3] of the pairs, with b^T F a = 0."""
        inverse = np.linalg.inv(geometry.K)
        b_T_a = self._relative(geometry)
        R, t = b_T_a[:, :3, :3], b_T_a[:, :3, 3]
        t = t / np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-12)
        E = _cross(t) @ R
        return np.asarray(np.swapaxes(inverse[self.second], 1, 2) @ E @ inverse[self.first])

    def depths(self, geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
        """Depth of the matches in both images of their pair, [P, MOST] each, metres.

        Where the rays come nearest; behind the camera it is negative. NaN without parallax.
        """
        inverse = np.linalg.inv(geometry.K)
        b_T_a = self._relative(geometry)
        R, t = b_T_a[:, None, :3, :3], b_T_a[:, None, :3, 3]
        x = _rays(inverse[self.first], geometry.pixels(self.a))
        y = _rays(inverse[self.second], geometry.pixels(self.b))
        x = (R @ x[..., None])[..., 0]
        # z_b y = z_a x + t, in the frame of b
        normal = np.cross(x, y)
        square = (normal**2).sum(-1)
        lengths = np.linalg.norm(x, axis=-1) * np.linalg.norm(y, axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            z_a = -(np.cross(t, y) * normal).sum(-1) / square
            z_b = (np.cross(x, t) * normal).sum(-1) / square
            parallax = np.sqrt(square) / lengths > PARALLAX
        return np.where(parallax, z_a, np.nan), np.where(parallax, z_b, np.nan)

    def in_front(self, geometry: Geometry) -> float:
        """The share of the points with parallax that lie in front of both cameras; NaN: none."""
        z_a, z_b = self.depths(geometry)
        known = np.isfinite(z_a)
        if known.sum() < 20:
            return float("nan")
        return float(((z_a > 0) & (z_b > 0))[known].mean())

    def _relative(self, geometry: Geometry) -> np.ndarray:
        poses = geometry.world_T_cam
        lost = ~np.isfinite(poses).all((1, 2))
        whole = np.where(lost[:, None, None], np.eye(4), poses)
        b_T_a = np.linalg.inv(whole[self.second]) @ whole[self.first]
        b_T_a[lost[self.first] | lost[self.second]] = np.nan
        return np.asarray(b_T_a)


def given_of(capture: Capture) -> Given:
    """What a reader found of a capture; of any other capture, what it is itself."""
    if isinstance(capture, SourceCapture):
        return capture.given
    frames = [
        SourceFrame(name, camera_of(K, capture.size), pose, _Image(capture, index))
        for index, (name, K, pose) in enumerate(
            zip(capture.frames, capture.K, capture.world_T_cam, strict=True)
        )
    ]
    return Given(Path(capture.name), frames, capture.skipped)


@dataclass(frozen=True)
class _Image:
    capture: Capture
    index: int

    def __call__(self) -> np.ndarray:
        return self.capture.image(self.index)


def _intrinsics(frame: SourceFrame, settings: ReadSettings, size: tuple[int, int]) -> np.ndarray:
    """K [3, 3] of a frame's undistorted image of (width, height) ``size``."""
    camera, stated = (
        None if each is None else turned(pinhole_of(each), settings.turn)
        for each in (frame.camera, frame.stated)
    )
    assert camera is not None
    return mended_camera(camera, settings, stated).resized(size).K


@lru_cache(maxsize=10_000)
def pinhole_of(camera: Camera) -> Camera:
    """The camera of its undistorted images, which many ways to read a capture ask for."""
    return camera.pinhole(camera.size)


def _cross(t: np.ndarray) -> np.ndarray:
    """Matrices [P, 3, 3] that multiply by the cross product with t [P, 3]."""
    matrix = np.zeros((len(t), 3, 3))
    x, y, z = t.T
    matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2] = -z, y, -x
    matrix[:, 1, 0], matrix[:, 2, 0], matrix[:, 2, 1] = z, -y, x
    return matrix


def _rays(inverse_K: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Rays [P, M, 3] of depth 1 through pixels [P, M, 2]."""
    homogeneous = np.concatenate([pixels, np.ones((*pixels.shape[:2], 1))], -1)
    return np.asarray(homogeneous @ np.swapaxes(inverse_K, 1, 2))
