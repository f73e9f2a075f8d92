"""Points are followed to where they are, without drifting away."""

from collections.abc import Iterator

import numpy as np
import pytest

from helpers.corner import Corner
from tf_lab.poses.tracks import follow

STEP = np.array([1.3, -0.7])  # pixels an image


def moving(count: int) -> Iterator[tuple[int, np.ndarray]]:
    """A pattern that moves by STEP from image to image."""
    rng = np.random.default_rng(2)
    waves, phases = rng.normal(size=(40, 2)) * 0.35, rng.uniform(0, 6, 40)
    u, v = np.meshgrid(np.arange(120.0), np.arange(90.0))
    for i in range(count):
        places = np.stack([u, v], -1) - i * STEP
        grey = 127 + 10 * np.sin(places @ waves.T + phases).sum(-1)
        yield i, np.clip(grey, 0, 255).astype(np.uint8)


def starts(frame: np.ndarray, point: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """Each sighting's pixel, less the way since image 0: the same for all of a point."""
    return pixel - frame[:, None] * STEP


@pytest.mark.parametrize("kept", [range(12), (0, 4, 8, 11)])
def test_points_move_as_the_images_do(kept: range | tuple[int, ...]) -> None:
    tracks = follow(moving(12), kept)
    assert len(tracks.frame) > 200 and set(tracks.frame) == set(kept)
    home = starts(*tracks)
    first = np.unique(tracks.point, return_index=True)[1][tracks.point]
    off = np.linalg.norm(home - home[first], axis=1)
    late = tracks.frame - tracks.frame[first] >= 8
    assert np.median(off[late]) < 0.05, "pixels, however long they are followed"
    assert np.quantile(off, 0.95) < 0.3
    assert np.bincount(tracks.point).min() >= 3, "seen in at least three"


def test_a_point_is_seen_once_an_image() -> None:
    tracks = follow(moving(8), range(8))
    rows = np.stack([tracks.frame, tracks.point])
    assert len(np.unique(rows, axis=1).T) == len(tracks.frame)
    assert (np.diff(tracks.frame) >= 0).all()
    assert set(tracks.point) == set(range(tracks.point.max() + 1))


def test_in_a_corner_points_stay_on_the_walls() -> None:
    """Under perspective, too: the wall's point of a sighting is the first sighting's."""
    corner = Corner(12)
    tracks = follow(((i, corner.image(i)[..., 0]) for i in range(12)), range(12))
    seen = [corner.points(i) for i in range(12)]
    x, y = np.round(tracks.pixel).astype(int).T
    points = np.stack([seen[f][v, u] for f, u, v in zip(tracks.frame, x, y, strict=True)])
    first = np.unique(tracks.point, return_index=True)[1][tracks.point]
    off = np.linalg.norm(points - points[first], axis=1)
    assert np.median(off) < 0.015, "metres: half a pixel is 8 mm at 2 m"
    assert len(tracks.frame) > 1000


def test_nothing_to_follow() -> None:
    flat = np.full((90, 120), 80, np.uint8)
    assert len(follow(((i, flat) for i in range(5)), range(5)).frame) == 0
    assert len(follow((), ()).frame) == 0
    assert len(follow(moving(2), range(2)).frame) == 0, "two images are fewer than three"
