"""A capture in figures: its frames, its path, how its images look, how they overlap."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tf_lab.data.capture import Capture
from tf_lab.data.diagnosis.evidence import Evidence, given_of
from tf_lab.data.diagnosis.matches import Album
from tf_lab.data.gravity import DIRECTION_FILE
from tf_lab.data.keyframes import select_keyframes
from tf_lab.data.readers.source import SourceCapture
from tf_lab.data.reading import ReadSettings
from tf_lab.errors import TFLabError

DEPTH_FRAMES = 12  # whose depth is looked at
MOST_IMAGES = 1000  # that are read to see whether they can be
BLURRED = 20.0  # variance of the Laplacian below which an image shows no edge
DARK, BRIGHT = 30.0, 225.0  # mean grey values


Track = Callable[[Sequence[int]], Iterable[int]]


@dataclass(frozen=True)
class Statistics:
    """Figures of a capture as it was read; lengths in metres if its poses are.

    Attributes:
        frames, keyframes, lost: counts; lost are those left out.
        looked_at: of how many frames the image was read; all, unless they are very many.
        unread: "frame: why" of each image that cannot be read.
        size: (width, height) of the images, pixels.
        field_of_view: horizontal and vertical, degrees.
        path: length of the way of the camera.
        extent: of its places along x, y and z (up).
        height: of the median camera above the lowest depth seen; NaN: no depth.
        up: the direction [3] of up in the source's world.
        up_from: how that was found.
        blur: median variance of the Laplacian of the grey values; sharp images have hundreds.
        blurred: share of images below `BLURRED`.
        exposure: median of the images' mean grey values, 0 to 255.
        ill_exposed: share of images that are nearly black or white.
        unread_depth: why, if most of the depth maps looked at cannot be read; empty: they can.
        overlap: how many keyframes have the median matched point in view; NaN: no such point.
    """

    frames: int
    keyframes: int
    lost: int
    looked_at: int
    unread: tuple[str, ...]
    size: tuple[int, int]
    field_of_view: tuple[float, float]
    path: float
    extent: tuple[float, float, float]
    height: float
    up: tuple[float, float, float]
    up_from: str
    blur: float
    blurred: float
    exposure: float
    ill_exposed: float
    unread_depth: str
    overlap: float


def describe(
    album: Album, evidence: Evidence, best: ReadSettings, path: Path, track: Track = iter
) -> Statistics:
    """The figures; blur and exposure are of the images that were matched.

    Args:
        album: the images.
        evidence: their matches.
        best: how the capture is best read.
        path: from where.
        track: shows how far the reading of all images is.
    """
    capture = album.capture
    centres = capture.world_T_cam[:, :3, 3]
    keyframes = select_keyframes(capture.world_T_cam)
    K, (width, height) = capture.K[0], capture.size
    blur = np.array(list(album.sharpness.values()) or [np.nan])
    grey = np.array(list(album.brightness.values()) or [np.nan])
    up = capture.source_T_world[:3, 2]
    up = up / np.linalg.norm(up)
    count = len(capture.frames)
    looked_at = np.unique(np.linspace(0, count - 1, min(count, MOST_IMAGES)).astype(int)).tolist()
    extent = np.ptp(centres, axis=0)
    return Statistics(
        frames=len(capture.frames),
        keyframes=len(keyframes),
        lost=len(capture.skipped),
        looked_at=len(looked_at),
        unread=tuple(f"{capture.frames[i]}: {why}" for i, why in _unread(album, track(looked_at))),
        size=capture.size,
        field_of_view=(_angle(width, K[0, 0]), _angle(height, K[1, 1])),
        path=float(np.linalg.norm(np.diff(centres, axis=0), axis=1).sum()),
        extent=(float(extent[0]), float(extent[1]), float(extent[2])),
        height=_height(capture),
        up=(float(up[0]), float(up[1]), float(up[2])),
        up_from=_how_up(capture, evidence.settings, path),
        blur=float(np.median(blur)),
        blurred=float((blur < BLURRED).mean()),
        exposure=float(np.median(grey)),
        ill_exposed=float(((grey < DARK) | (grey > BRIGHT)).mean()),
        unread_depth=_unread_depth(capture),
        overlap=_overlap(evidence, best, keyframes),
    )


def _unread(album: Album, frames: Iterable[int]) -> Iterator[tuple[int, TFLabError]]:
    """Which of the frames have no image that can be read, and why."""
    for index in frames:
        if index not in album.sharpness:  # else it was read
            try:
                album.capture.image(index)
            except TFLabError as error:
                yield index, error


def _angle(pixels: int, focal: float) -> float:
    """Field of view in degrees."""
    return math.degrees(2 * math.atan(pixels / (2 * focal)))


def _how_up(capture: Capture, settings: ReadSettings, path: Path) -> str:
    if not isinstance(capture, SourceCapture):
        return "when it was prepared"
    folder = path if path.is_dir() else path.parent
    if (folder / DIRECTION_FILE).exists():
        return DIRECTION_FILE
    if settings.gravity is not None:
        return "gravity="
    return "the layout" if given_of(capture).down is not None else "estimated from the poses"


def _some_frames(capture: Capture) -> list[int]:
    """Whose depth is looked at."""
    count = len(capture.frames)
    return sorted({int(i) for i in np.linspace(0, count - 1, DEPTH_FRAMES)})


def _unread_depth(capture: Capture) -> str:
    """Why most of the depth maps looked at cannot be read; empty: they can, or there are none."""
    frames, reasons = _some_frames(capture), []
    for index in frames:
        try:
            capture.depth(index)
        except TFLabError as error:
            reasons.append(str(error))
    return reasons[0] if len(reasons) > len(frames) / 2 else ""


def _height(capture: Capture) -> float:
    """Of the median camera above what is lowest in the depth maps, metres."""
    lowest = []
    for index in _some_frames(capture):
        try:
            depth = capture.depth(index)
        except TFLabError:
            continue
        if depth is None or not (depth > 0).any():
            continue
        v, u = (np.arange(0, n, max(1, n // 48)) for n in depth.shape)
        z = depth[np.ix_(v, u)].ravel()
        columns, rows = np.meshgrid(u, v)
        pixels = np.stack([columns.ravel(), rows.ravel(), np.ones(z.size)], axis=1)
        points = (pixels @ np.linalg.inv(capture.K[index]).T * z[:, None])[z > 0]
        pose = capture.world_T_cam[index]
        lowest.append(np.quantile(points @ pose[2, :3] + pose[2, 3], 0.01))
    if not lowest:
        return float("nan")
    return float(np.median(capture.world_T_cam[:, 2, 3]) - min(lowest))


def _overlap(evidence: Evidence, best: ReadSettings, keyframes: list[int]) -> float:
    """In how many keyframes' images the median matched point lies."""
    geometry = evidence.geometry(best)
    if not len(evidence.pairs):
        return float("nan")
    z, _ = evidence.depths(geometry)
    pixels = geometry.pixels(evidence.a)
    ones = np.ones((*z.shape, 1))
    rays = np.concatenate([pixels, ones], -1) @ np.swapaxes(
        np.linalg.inv(geometry.K[evidence.first]), 1, 2
    )
    poses = geometry.world_T_cam[evidence.first]
    points = (rays * z[..., None]) @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3]
    points = points[(z > 0) & np.isfinite(points).all(-1)]
    if not len(points):
        return float("nan")
    points = points[np.random.default_rng(0).permutation(len(points))[:400]]
    wide, high = evidence.capture.size if geometry.turn % 180 == 0 else evidence.capture.size[::-1]
    seen = np.zeros(len(points))
    for pose, K in evidence.posed(best, keyframes):
        if not np.isfinite(pose).all():
            continue
        cam = (points - pose[:3, 3]) @ pose[:3, :3]
        uvw = cam @ K.T
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = uvw[:, 0] / uvw[:, 2], uvw[:, 1] / uvw[:, 2]
        seen += (uvw[:, 2] > 0) & (u > -0.5) & (u < wide - 0.5) & (v > -0.5) & (v < high - 0.5)
    return float(np.median(seen))
