"""Plane-sweep scores and the choice of sources: against loops over their definitions."""

import numpy as np
import pytest
import torch

from tf_lab.stereo.cost import View, sweep
from tf_lab.stereo.sources import choose_sources

K = np.array([[20.0, 0, 11.5], [0, 20.0, 8.5], [0, 0, 1]])
BASELINE = (0.05, 0.8, 0.25)


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    """A camera that looks along z, turned about its vertical."""
    made = np.eye(4)
    made[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    made[:3, 3] = x, y, z
    return made


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((18, 24)).astype(np.float32)


def bilinear(image: np.ndarray, x: float, y: float) -> float:
    left, top = min(int(x), image.shape[1] - 2), min(int(y), image.shape[0] - 2)
    fx, fy = x - left, y - top
    upper = (1 - fx) * image[top, left] + fx * image[top, left + 1]
    lower = (1 - fx) * image[top + 1, left] + fx * image[top + 1, left + 1]
    return float((1 - fy) * upper + fy * lower)


def window_by_hand(view: View, source: View, u: int, v: int, depth: float) -> float:
    """ZNCC of the 3x3 windows around a pixel and around where a plane takes it."""
    source_T_view = np.linalg.inv(source.world_T_cam) @ view.world_T_cam
    here, there = [], []
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            ray = np.linalg.inv(view.K) @ [u + du, v + dv, 1]
            x, y, z = source.K @ (source_T_view @ [*(depth * ray), 1])[:3]
            here.append(view.grey[v + dv, u + du])
            there.append(bilinear(source.grey, x / z, y / z))
    return float(np.corrcoef(here, there)[0, 1])


def test_scores_are_the_correlation_of_windows() -> None:
    view = View(noise(0), K, pose())
    sources = [View(noise(1), K, pose(0.1, yaw=0.05)), View(noise(2), K, pose(-0.1, 0.05, 0.02))]
    inverse = np.linspace(0.3, 1.0, 4)
    every = [sweep(view, [source], inverse, 3, 1) for source in sources]
    for source, scores in zip(sources, every, strict=True):
        for plane, (u, v) in enumerate([(11, 9), (12, 7), (10, 8), (13, 10)]):
            expected = window_by_hand(view, source, u, v, 1 / inverse[plane])
            assert scores[plane, v, u] == pytest.approx(expected, abs=2e-3)  # cv2.remap: 1/32 pixel
    np.testing.assert_allclose(sweep(view, sources, inverse, 3, 1), np.maximum(*every))
    both = sweep(view, sources, inverse, 3, 2)
    np.testing.assert_allclose(both, np.mean(every, axis=0), atol=1e-6)


def test_threads_change_nothing() -> None:
    view = View(noise(0), K, pose())
    sources = [View(noise(i), K, pose(0.1 * i)) for i in range(1, 5)]
    inverse = np.linspace(0.3, 1.0, 20)
    alone = sweep(view, sources, inverse, 3, 2)
    threads = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        np.testing.assert_array_equal(sweep(view, sources, inverse, 3, 2), alone)
    finally:
        torch.set_num_threads(threads)


def test_what_a_source_does_not_see_scores_least() -> None:
    view = View(noise(0), K, pose())
    behind = View(noise(0), K, pose(z=3.0))  # the planes at 1 and 2 m lie behind it
    assert (sweep(view, [behind], np.array([1.0, 0.5]), 3, 1) == -1).all()
    beside = View(noise(0), K, pose(x=0.6))  # 12 pixels to the right, half of the image, at 1 m
    scores = sweep(view, [beside], np.array([1.0]), 3, 1)[0]
    assert (scores[:, :12] == -1).all() and (scores[:, 12:] > -1).mean() > 0.9


def test_many_planes_are_more_rows_than_opencv_takes_at_once() -> None:
    view, source = View(noise(0), K, pose()), View(noise(1), K, pose(0.1))
    inverse = np.linspace(0.2, 1.0, 2000)  # 36,000 rows
    some = sweep(view, [source], inverse[-3:], 3, 1)
    np.testing.assert_array_equal(sweep(view, [source], inverse, 3, 1)[-3:], some)


def test_sources_have_a_fair_baseline_and_look_the_same_way() -> None:
    poses = np.stack(
        [
            pose(),
            pose(0.3),
            pose(0.25),
            pose(0.02),  # too near
            pose(1.0),  # too far
            pose(0.25, yaw=1.0),  # looks elsewhere
            pose(0.5, yaw=0.3),
        ]
    )
    assert choose_sources(poses, 0, 9, BASELINE) == [2, 1, 6]
    assert choose_sources(poses, 0, 2, BASELINE) == [2, 1]
    assert choose_sources(poses[:1], 0, 2, BASELINE) == []
