"""Points that two images share, found without any pose: SIFT between frames of moderate motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from tf_lab.data.capture import Capture
from tf_lab.errors import TFLabError

RATIO = 0.7  # Lowe's: the best match must be so much better than the second
FEATURES = 1200  # an image
LEAST = 16  # matches of a pair that is of use
MOST = 150  # matches kept of a pair
# The median motion of a good pair, as a share of the image's width: parallax, and yet overlap.
MOTION = (0.04, 0.16)
MAX_GAP = 64  # frames
TOLERANCE = 1.5  # pixels at 640 columns: of the epipolar geometry without any camera


@dataclass(frozen=True)
class Pair:
    """Matches of frames ``i`` and ``j`` of a capture.

    Attributes:
        a, b: [M, 2] pixels in the images of i and j.
        floor: median Sampson distance, pixels, to the best fundamental matrix: what remains
            whatever cameras and poses are.
    """

    i: int
    j: int
    a: np.ndarray
    b: np.ndarray
    floor: float


@dataclass(frozen=True)
class Features:
    """Keypoints of an image: [N, 2] pixels, [N, 128] descriptors (RootSIFT)."""

    points: np.ndarray
    descriptors: np.ndarray


class Album:
    """The features of a capture's images, found when they are asked for.

    Args:
        capture: whose images.
        width: pixels; larger images are made smaller.

    Attributes:
        sharpness, brightness: of every image read so far, by frame: the variance of the Laplacian
            of grey values, and their mean (0 to 255).
    """

    def __init__(self, capture: Capture, width: int = 640) -> None:
        self.capture, self._width = capture, width
        self.sharpness: dict[int, float] = {}
        self.brightness: dict[int, float] = {}
        self._features: dict[int, Features] = {}
        self._sift = cv2.SIFT.create(FEATURES, contrastThreshold=0.02)

    def features(self, index: int) -> Features:
        """Of one frame; none, if its image cannot be read."""
        if index not in self._features:
            self._features[index] = self._found(index)
        return self._features[index]

    def _found(self, index: int) -> Features:
        try:
            grey = cv2.cvtColor(self.capture.image(index), cv2.COLOR_RGB2GRAY)
        except TFLabError:
            return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
        factor = self._width / max(grey.shape[1], self._width)
        if factor < 1:
            small = (self._width, max(1, round(factor * grey.shape[0])))
            grey = cv2.resize(grey, small, interpolation=cv2.INTER_AREA)
        self.sharpness[index] = float(cv2.Laplacian(grey, cv2.CV_64F).var())
        self.brightness[index] = float(grey.mean())
        keypoints, descriptors = self._sift.detectAndCompute(grey, None)
        if descriptors is None:
            return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
        points = np.array([keypoint.pt for keypoint in keypoints])
        size = self.capture.size
        points = (points + 0.5) * [size[0] / grey.shape[1], size[1] / grey.shape[0]] - 0.5
        roots = np.sqrt(descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-6))
        return Features(points, roots.astype(np.float32))


def match_capture(album: Album, pairs: int) -> list[Pair]:
    """About so many pairs of frames with matches, spread over the capture.

    Which frames make a pair is up to the images alone: poses may be wrong, or in any unit. From
    frames evenly spread, partners are looked for at growing distances in time.
    """
    count, generator = len(album.capture.frames), np.random.default_rng(0)
    anchors = np.unique(np.linspace(0, max(0, count - 2), -(-pairs // 2)).astype(int))
    found: list[Pair] = []
    gap = 1
    for anchor in anchors:
        for pair, motion in _partners(album, int(anchor), gap, generator):
            found.append(pair)
            gap = min(pair.j - pair.i, MAX_GAP) if motion > MOTION[0] else gap
    return found


def _partners(
    album: Album, i: int, gap: int, generator: np.random.Generator
) -> Iterator[tuple[Pair, float]]:
    """Up to two pairs of a frame and later ones, and how much their points move."""
    count, wide = len(album.capture.frames), album.capture.size[0]
    tried: dict[int, tuple[Pair, float] | None] = {}
    for _ in range(6):
        j = min(i + gap, count - 1)
        if j <= i or gap in tried:
            break
        pair = match_pair(album, i, j, generator)
        motion = _motion(pair) / wide if pair is not None else np.inf
        tried[gap] = None if pair is None else (pair, motion)
        if motion < MOTION[0] and gap < MAX_GAP and i + gap < count - 1:
            gap *= 2
        elif motion > MOTION[1] and gap > 1:
            gap //= 2
        else:
            break
    good = [entry for entry in tried.values() if entry is not None]
    good.sort(key=lambda entry: abs(np.log(max(entry[1], 1e-4) / 0.08)))
    yield from good[:2]


def _motion(pair: Pair) -> float:
    return float(np.median(np.linalg.norm(pair.a - pair.b, axis=1)))


def match_pair(album: Album, i: int, j: int, generator: np.random.Generator) -> Pair | None:
    """The matches of two frames that some fundamental matrix explains; None: too few.

    No intrinsics are used, so that wrong ones show in what is kept.
    """
    first, second = album.features(i), album.features(j)
    if min(len(first.points), len(second.points)) < LEAST:
        return None
    closeness = first.descriptors @ second.descriptors.T  # of unit vectors
    there, back = _best(closeness), closeness.argmax(0)
    rows = np.flatnonzero(there >= 0)
    rows = rows[back[there[rows]] == rows]
    if len(rows) < LEAST:
        return None
    a, b = first.points[rows], second.points[there[rows]]
    tolerance = TOLERANCE * max(album.capture.size[0], 320) / 640
    cv2.setRNGSeed(0)
    try:
        F, inliers = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, tolerance, 0.999, 2000)
    except cv2.error:  # an assertion of its own, where no model is found
        return None
    if F is None or F.shape != (3, 3) or inliers is None or inliers.sum() < LEAST:
        return None
    kept = np.flatnonzero(inliers.ravel())
    if len(kept) > MOST:
        kept = np.sort(generator.choice(kept, MOST, replace=False))
    floor = float(np.median(sampson_pixels(F, a[kept], b[kept])))
    return Pair(i, j, a[kept], b[kept], floor)


def _best(closeness: np.ndarray) -> np.ndarray:
    """The best column of each row, -1 where the second is nearly as good."""
    two = np.argpartition(-closeness, 1, axis=1)[:, :2]
    rows = np.arange(len(closeness))[:, None]
    order = np.argsort(-closeness[rows, two], axis=1)
    best, second = two[rows, order].T
    distances = np.sqrt(np.maximum(2 - 2 * closeness[rows, np.stack([best, second], 1)], 0))
    return np.where(distances[:, 0] < RATIO * distances[:, 1], best, -1)


def sampson_pixels(F: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sampson distance [..., M] in pixels of matches a, b [..., M, 2] to F [..., 3, 3].

    The first-order distance to the nearest pair of points with b^T F a = 0 (Hartley and Zisserman,
    Multiple View Geometry, 2nd ed., eq. 11.9, its root).
    """
    one = np.ones((*a.shape[:-1], 1))
    x, y = np.concatenate([a, one], -1), np.concatenate([b, one], -1)
    of_x = x @ np.swapaxes(F, -1, -2)  # lines in the second image
    of_y = y @ F
    error = (y * of_x).sum(-1)
    slope = (of_x[..., :2] ** 2).sum(-1) + (of_y[..., :2] ** 2).sum(-1)
    return np.abs(error) / np.sqrt(np.maximum(slope, 1e-30))
