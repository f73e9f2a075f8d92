"""Corners followed through a sequence of images (Lucas and Kanade 1981, Shi and Tomasi 1994)."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import cv2
import numpy as np

POINTS = 300  # that are followed at a time
QUALITY = 0.005  # of a corner, of the best one's
APART = 3  # pixels between corners
LEAST = 3  # kept images that a point must be seen in
RETURN = 0.5  # pixels; a point that is followed back must come so near to where it was
DRIFT = 2.0  # pixels, between the point as it was followed and as it was first seen
LUCAS_KANADE: dict[str, Any] = {
    "winSize": (11, 11),
    "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.003),
}
LEVELS, LEVELS_NEAR = 3, 1  # of the pyramid, without and with a guess


class Tracks(NamedTuple):
    """Where points were seen, one row a sighting.

    Attributes:
        frame: int [N], the number of the image.
        point: int [N], the number of the point, 0 to M - 1.
        pixel: float64 [N, 2], x and y.
    """

    frame: np.ndarray
    point: np.ndarray
    pixel: np.ndarray


@dataclass
class _Points:
    """What is followed: numbers [P], pixels now [P, 2]; where each began: image [P], pixel."""

    number: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    pixel: np.ndarray = field(default_factory=lambda: np.empty((0, 2), np.float32))
    origin: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    start: np.ndarray = field(default_factory=lambda: np.empty((0, 2), np.float32))

    def only(self, held: np.ndarray) -> _Points:
        """Those of a mask."""
        return _Points(self.number[held], self.pixel[held], self.origin[held], self.start[held])

    def with_new(self, corners: np.ndarray, first_number: int, image: int) -> _Points:
        """And corners that begin in an image."""
        return _Points(
            np.concatenate([self.number, first_number + np.arange(len(corners))]),
            np.concatenate([self.pixel, corners]),
            np.concatenate([self.origin, np.full(len(corners), image)]),
            np.concatenate([self.start, corners]),
        )


def follow(images: Iterable[tuple[int, np.ndarray]], kept: Collection[int]) -> Tracks:
    """Follow corners from image to image; lost ones are replaced by new ones.

    Followed from one to the next alone a point would drift away, half a pixel in a few keyframes.
    So in every kept image it is found again as it looked where it began.

    Args:
        images: numbers, and grey images uint8 [H, W], in temporal order, all of one size.
        kept: numbers of the images whose sightings are told and where points begin; the others
            lead from one to the next.

    Returns:
        The sightings, in the order of the images, of points with at least `LEAST`.
    """
    points, total = _Points(), 0
    before: np.ndarray | None = None
    begun: list[np.ndarray] = []
    sightings = [(points.number, points.number, np.empty((0, 2)))]
    for number, image in images:
        if before is not None and len(points.number):
            points.pixel, found = _followed(before, image, points.pixel)
            points = points.only(found)
        before = image
        if number not in kept:
            continue
        points = _found_again(points, begun, image)
        corners = _corners(image, points.pixel)
        points = points.with_new(corners, total, len(begun))
        total += len(corners)
        begun.append(image)
        where = points.pixel.astype(np.float64)
        sightings.append((np.full(len(where), number), points.number, where))
    frame, point, pixel = (np.concatenate(part) for part in zip(*sightings, strict=True))
    often = np.bincount(point, minlength=total)[point] >= LEAST
    return Tracks(frame[often], np.unique(point[often], return_inverse=True)[1], pixel[often])


def _found_again(points: _Points, begun: list[np.ndarray], image: np.ndarray) -> _Points:
    """Points where the image looks as they did where they began; others are given up."""
    held = np.zeros(len(points.number), bool)
    for k in np.unique(points.origin):
        those = np.flatnonzero(points.origin == k)
        guess = points.pixel[those]
        exact, found = _followed(begun[k], image, points.start[those], guess)
        found &= np.linalg.norm(exact - guess, axis=-1) < DRIFT
        points.pixel[those[found]] = exact[found]
        held[those[found]] = True
    return points.only(held)


def _followed(
    before: np.ndarray, image: np.ndarray, pixels: np.ndarray, guess: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Where points of an image before are in this one, [N, 2], and which were found, [N]."""
    options = {**LUCAS_KANADE, "maxLevel": LEVELS}
    start: Any = None
    home: Any = None
    if guess is not None:
        options |= {"maxLevel": LEVELS_NEAR, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
        start, home = guess[:, None].copy(), pixels[:, None].copy()
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, image, pixels[:, None], start, **options)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(image, before, there, home, **options)
    near = np.linalg.norm(back[:, 0] - pixels, axis=-1) < RETURN
    height, width = image.shape
    inside = ((there[:, 0] >= 0) & (there[:, 0] <= (width - 1, height - 1))).all(-1)
    return there[:, 0], (found[:, 0] > 0) & (returned[:, 0] > 0) & near & inside


def _corners(image: np.ndarray, held: np.ndarray) -> np.ndarray:
    """New corners float32 [N, 2], apart from the held ones, until there are enough."""
    none = np.empty((0, 2), np.float32)
    if len(held) >= POINTS:
        return none
    mask = np.full(image.shape, 255, np.uint8)
    for x, y in held:
        cv2.circle(mask, (round(float(x)), round(float(y))), APART, 0, -1)
    corners = cv2.goodFeaturesToTrack(image, POINTS - len(held), QUALITY, APART, mask=mask)
    return none if corners is None else corners[:, 0]
