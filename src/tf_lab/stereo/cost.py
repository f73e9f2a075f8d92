"""The scores of a plane sweep (Collins 1996): how well views match at every depth of a view."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import cv2
import numpy as np
import torch

LEAST_DEPTH = 1e-3  # metres, before a source
FLAT = 1e-6  # variance of a window (grey values are 0..1) that counts as none


class View(NamedTuple):
    """A grey image float32 [H, W] in 0..1, K [3, 3] in its pixels, world_T_cam [4, 4]."""

    grey: np.ndarray
    K: np.ndarray
    world_T_cam: np.ndarray


def sweep(
    view: View, sources: Sequence[View], inverse: np.ndarray, window: int, best: int
) -> np.ndarray:
    """Zero-mean normalised cross-correlation (ZNCC) of a view with its best sources.

    Args:
        view: whose depth is looked for.
        sources: one or more views of the same size.
        inverse: inverse depths [P] of the planes, 1 / metres.
        window: edge of the window that is correlated, pixels.
        best: how many sources count at a pixel: in the others it may be hidden.

    Returns:
        float32 [P, H, W] in -1..1; -1 counts for a source that does not see the point.
    """
    here = _Windows(view.grey[None], window)

    def score_of(source: View) -> np.ndarray:
        warped, seen = _warp(view, source, inverse)
        return np.where(seen, here.correlation(_Windows(warped, window)), np.float32(-1))

    top: list[np.ndarray] = []  # the greatest so far at every pixel, in order
    for score in _mapped(score_of, sources):
        for k, known in enumerate(top):
            top[k], score = np.maximum(known, score), np.minimum(known, score)
        if len(top) < best:
            top.append(score)
    return np.mean(top, axis=0)


def _mapped(score_of: Callable[[View], np.ndarray], views: Sequence[View]) -> Iterator[np.ndarray]:
    """Scores of views in their order, by as many threads as torch has: they wait for no lock."""
    threads = min(torch.get_num_threads(), len(views))
    if threads == 1:
        yield from map(score_of, views)
        return
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(score_of, views)


def _warp(view: View, source: View, inverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A source as each plane shows it to the view, float32 [P, H, W]; and where it sees it."""
    height, width = view.grey.shape
    source_T_view = np.linalg.inv(source.world_T_cam) @ view.world_T_cam
    infinite = source.K @ source_T_view[:3, :3] @ np.linalg.inv(view.K)  # pixels to pixels
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    far = (infinite @ np.stack([u, v, np.ones_like(u)]).reshape(3, -1)).astype(np.float32)
    near = (source.K @ source_T_view[:3, 3]).astype(np.float32)
    planes = inverse.astype(np.float32)[:, None]
    depth = far[2] + near[2] * planes  # over that in the view
    front = depth > LEAST_DEPTH * planes
    scale = 1 / np.where(front, depth, 1)
    x, y = ((far[k] + near[k] * planes) * scale for k in (0, 1))
    seen = front & (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    maps = [np.where(seen, part, -1).reshape(-1, width) for part in (x, y)]
    warped = _remap(source.grey, maps[0], maps[1], height)
    return warped.reshape(-1, height, width), seen.reshape(-1, height, width)


def _remap(image: np.ndarray, x: np.ndarray, y: np.ndarray, height: int) -> np.ndarray:
    """Bilinear samples at float32 pixels [N * height, W]; OpenCV takes no more rows than int16."""
    rows = max(1, 32_000 // height) * height
    parts = [
        cv2.remap(
            image,
            x[start : start + rows],
            y[start : start + rows],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for start in range(0, len(x), rows)
    ]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


class _Windows:
    """Images [P, H, W] with the means and deviations of their windows."""

    def __init__(self, images: np.ndarray, window: int) -> None:
        self.images, self.window = images, window
        self.mean = _box(images, window)
        variance = _box(images * images, window) - self.mean * self.mean
        self.deviation = np.sqrt(np.maximum(variance, 0) + FLAT)

    def correlation(self, others: _Windows) -> np.ndarray:
        """ZNCC [P, H, W] with the windows at the same places of others."""
        covariance = _box(self.images * others.images, self.window) - self.mean * others.mean
        return covariance / (self.deviation * others.deviation)


def _box(images: np.ndarray, window: int) -> np.ndarray:
    """Means of windows around every pixel of [P, H, W]."""
    means = np.empty_like(images)
    for image, mean in zip(images, means, strict=True):
        cv2.boxFilter(image, -1, (window, window), dst=mean, borderType=cv2.BORDER_REFLECT)
    return means
