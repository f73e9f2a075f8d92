"""Colour against depth: the colour camera under which images, warped by depth, agree best.

Points of a frame's depth map are looked up in its own colour image and, by the poses, in a
neighbour's: with the right colour camera they have the same brightness. The score of a pair is
their zero-mean normalised cross-correlation (ZNCC).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from tf_lab.data.capture import Capture
from tf_lab.data.diagnosis.evidence import Evidence, Geometry
from tf_lab.data.diagnosis.search import Candidate
from tf_lab.errors import TFLabError

PAIRS = 24
BASELINE = (0.12, 0.7, 0.35)  # metres: least, most, best; near views agree under any camera
ALIKE = 0.87  # cosine of the angle between the views
POINTS = 4000  # of a depth map
LEAST = 500  # that both images see
FACTORS = np.geomspace(0.75, 1.34, 25)
OFFSETS = np.arange(-0.06, 0.0601, 0.01)  # metres
GAIN = 0.03  # of ZNCC: less is no evidence
DRAWS = 500


@dataclass(frozen=True)
class Sensors:
    """How colour and depth fit.

    Attributes:
        pairs: how many were compared.
        score: mean ZNCC of the cameras as they are.
        focal: the best factor on the colour camera's focal length, the depth's staying.
        offset: (x, y) metres from where colour is taken for to where it fits best.
        best: mean ZNCC of both.
        apart: whether that is beyond doubt better, so that the two are not one camera.
        shared: by how much depth maps of two frames differ (median, relative) if depth's focal
            length is changed with the colour's to that of the best way to read the matches; NaN:
            that changes none.
        alone: the same if colour's alone is.
    """

    pairs: int
    score: float
    focal: float
    offset: tuple[float, float]
    best: float
    apart: bool
    shared: float
    alone: float


@dataclass(frozen=True)
class _View:
    """One pair: points [N, 3] in the camera of a, b's depth map, their grey images."""

    points: np.ndarray
    K_a: np.ndarray
    K_b: np.ndarray
    b_T_a: np.ndarray
    depth: np.ndarray
    a: np.ndarray
    b: np.ndarray

    def mismatch(self, depth_focal: float) -> float:
        """Median relative difference of a's depth, moved to b, and b's; NaN: no overlap."""
        points = self.points / [depth_focal, depth_focal, 1.0]
        moved = points @ self.b_T_a[:3, :3].T + self.b_T_a[:3, 3]
        seen = _look_up(self.depth, moved, self.K_b, depth_focal, cv2.INTER_NEAREST)
        known = seen > 0
        if known.sum() < LEAST:
            return float("nan")
        return float(np.median(np.abs(moved[known, 2] / seen[known] - 1)))

    def score(self, focal: float, offset: tuple[float, float]) -> float:
        """ZNCC; NaN if too few points are seen by both."""
        points = self.points
        moved = points @ self.b_T_a[:3, :3].T + self.b_T_a[:3, 3]
        x, y = (
            _look_up(image, seen - [*offset, 0.0], K, focal)
            for image, seen, K in ((self.a, points, self.K_a), (self.b, moved, self.K_b))
        )
        known = (x > 0) & (y > 0)
        if known.sum() < LEAST:
            return float("nan")
        return float(np.corrcoef(x[known], y[known])[0, 1])


def compare_sensors(evidence: Evidence, best: Candidate) -> Sensors | None:
    """Colour against depth under the best way to read the poses; None: no depth, or no overlap."""
    given = evidence.settings
    focal = best.settings.focal_scale / given.focal_scale
    posed = evidence.geometry(best.settings)
    if posed.turn or best.settings.intrinsics_size != given.intrinsics_size:
        return None  # depth would have to be read anew
    views = _views(evidence, posed, focal)
    if len(views) < 3:
        return None

    def scores(focal: float, offset: tuple[float, float]) -> np.ndarray:
        return np.array([view.score(focal, offset) for view in views])

    here = (0.0, 0.0)
    curve = [_mean(scores(float(f), here)) for f in FACTORS]
    found = float(FACTORS[int(np.nanargmax(curve))])
    x = max(OFFSETS, key=lambda v: _mean(scores(found, (float(v), 0.0))))
    y = max(OFFSETS, key=lambda v: _mean(scores(found, (float(x), float(v)))))
    offset = (float(x), float(y))
    near = found * np.linspace(0.97, 1.03, 13)
    found = float(max(near, key=lambda f: _mean(scores(float(f), offset))))
    as_given, at_best = scores(1.0, here), scores(found, offset)
    changed = abs(np.log(focal)) > 0.01
    return Sensors(
        len(views),
        _mean(as_given),
        found,
        offset,
        _mean(at_best),
        _sure(at_best - as_given),
        _mismatch(views, focal) if changed else float("nan"),
        _mismatch(views, 1.0) if changed else float("nan"),
    )


def _mismatch(views: list[_View], depth_focal: float) -> float:
    """The geometric mean over the pairs."""
    values = np.array([view.mismatch(depth_focal) for view in views])
    values = values[np.isfinite(values)]
    return float(np.exp(np.log(values + 1e-4).mean())) if len(values) else float("nan")


def _mean(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else -1.0


def _sure(gains: np.ndarray) -> bool:
    """Whether pairs gain as a whole, and enough."""
    gains = gains[np.isfinite(gains)]
    if len(gains) < 3 or gains.mean() < GAIN:
        return False
    draws = np.random.default_rng(0).integers(0, len(gains), (DRAWS, len(gains)))
    return bool((gains[draws].mean(1) <= 0).mean() < 0.01)


def _views(evidence: Evidence, geometry: Geometry, focal: float) -> list[_View]:
    capture, found = evidence.capture, []
    for first, second in _partners(geometry.world_T_cam):
        K = geometry.K[[first, second]].copy()
        K[:, [0, 1], [0, 1]] /= focal
        a, b = evidence.frames[first], evidence.frames[second]
        try:
            points, depth = _points(capture, a, K[0]), capture.depth(b)
        except TFLabError:
            continue
        if points is not None and depth is not None:
            b_T_a = np.linalg.inv(geometry.world_T_cam[second]) @ geometry.world_T_cam[first]
            found.append((a, b, (points, K[0], K[1], b_T_a, depth)))
    greys = dict(_greys(capture, {frame for a, b, _ in found for frame in (a, b)}))
    return [_View(*pair, greys[a], greys[b]) for a, b, pair in found if {a, b} <= greys.keys()]


def _partners(world_T_cam: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of poses of some baseline that look much the same way."""
    known = np.flatnonzero(np.isfinite(world_T_cam).all((1, 2)))
    centres, forward = world_T_cam[known, :3, 3], world_T_cam[known, :3, 2]
    baselines = np.linalg.norm(centres[:, None] - centres, axis=-1)
    fits = (forward @ forward.T > ALIKE) & (BASELINE[0] < baselines) & (baselines < BASELINE[1])
    found = []
    for first in np.unique(np.linspace(0, len(known) - 1, PAIRS).astype(int)) if len(known) else ():
        partners = np.flatnonzero(fits[first])
        if len(partners):
            second = min(partners, key=lambda k: abs(baselines[first, k] - BASELINE[2]))
            found.append((int(known[first]), int(known[second])))
    return found


def _points(capture: Capture, index: int, K: np.ndarray) -> np.ndarray | None:
    """Points [N, 3] of a depth map, in its camera, metres; None without one."""
    depth = capture.depth(index)
    if depth is None:
        return None
    step = max(1, round((depth.size / POINTS) ** 0.5))
    v, u = np.mgrid[step // 2 : depth.shape[0] : step, step // 2 : depth.shape[1] : step]
    z = depth[v, u].ravel()
    pixels = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1)
    return np.asarray((pixels @ np.linalg.inv(K).T * z[:, None])[z > 0])


def _greys(capture: Capture, frames: set[int]) -> Iterator[tuple[int, np.ndarray]]:
    """Grey values [H, W] from 1 to 256 (0 is outside) of those that can be read.

    In their order: going back, a video would have to be decoded again.
    """
    for index in sorted(frames):
        try:
            grey = cv2.cvtColor(capture.image(index), cv2.COLOR_RGB2GRAY).astype(np.float32)
        except TFLabError:
            continue
        yield index, cv2.GaussianBlur(grey, (3, 3), 0) + 1


def _look_up(
    image: np.ndarray, points: np.ndarray, K: np.ndarray, focal: float, way: int = cv2.INTER_LINEAR
) -> np.ndarray:
    """Values [N] of an image where a camera K of ``focal`` times the focal length sees."""
    z = np.where(points[:, 2] > 0.05, points[:, 2], np.nan)
    u = focal * K[0, 0] * points[:, 0] / z + K[0, 2]
    v = focal * K[1, 1] * points[:, 1] / z + K[1, 2]
    u, v = (np.nan_to_num(value, nan=-9.0).clip(-9, 30_000).astype(np.float32) for value in (u, v))
    return cv2.remap(image, u[:, None], v[:, None], way, borderMode=cv2.BORDER_CONSTANT)[:, 0]
