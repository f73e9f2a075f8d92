"""Depth maps of frames that come one by one, each from those before it."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import cv2
import numpy as np
import torch

from tf_lab.geometry import scale_intrinsics
from tf_lab.stereo.cost import View, sweep
from tf_lab.stereo.regularizer import SHIPPED, read_depth, shipped_regularizer
from tf_lab.stereo.sources import choose_sources

VERSION = 2  # changes whenever the depth of the same frames does
CHANNELS = 2  # of a depth map: metres (0: unknown), and how sure that is, 0..1


@dataclass(frozen=True)
class StereoSettings:
    """How depth is found.

    Attributes:
        width: pixels; wider images are made so narrow: what it costs is the same at any size.
        planes: between ``near`` and ``far`` (metres), of equal steps in inverse depth.
        sources: earlier frames that one is compared with, and ``best`` of them that count at a
            pixel.
        baseline: see `choose_sources`.
        window: of the correlation, pixels.
    """

    width: int = 80
    planes: int = 48
    near: float = 0.4
    far: float = 5.0
    sources: int = 10
    best: int = 3
    baseline: tuple[float, float, float] = (0.05, 0.8, 0.25)
    window: int = 5

    @property
    def inverse(self) -> np.ndarray:
        """Inverse depths [P] of the planes, 1 / metres, from far to near."""
        return np.linspace(1 / self.far, 1 / self.near, self.planes)


SETTINGS = StereoSettings()


@functools.cache
def stereo_identity() -> str:
    """Of all that shapes a depth map: the code's version, the settings and the weights."""
    digest = hashlib.sha256(json.dumps([VERSION, asdict(SETTINGS)]).encode())
    digest.update(SHIPPED.read_bytes())
    return digest.hexdigest()[:16]


class DepthSequence:
    """Frames so far, and the depth of each new one.

    Args:
        settings: see `StereoSettings`.
    """

    def __init__(self, settings: StereoSettings = SETTINGS) -> None:
        self.settings = settings
        self.views: list[View] = []

    def add(self, image: np.ndarray, K: np.ndarray, world_T_cam: np.ndarray) -> np.ndarray:
        """Depth, see `depth_of`, of a new frame: uint8 [H, W, 3], [3, 3] and [4, 4]."""
        self.views.append(small_view(image, K, world_T_cam, self.settings.width))
        return depth_of(self.views, len(self.views) - 1, self.settings)


def small_view(image: np.ndarray, K: np.ndarray, world_T_cam: np.ndarray, width: int) -> View:
    """A frame in grey, at most ``width`` pixels wide."""
    height, full = image.shape[:2]
    grey = image.astype(np.float32).mean(-1) / 255
    K = np.asarray(K, np.float64)
    if full > width:
        size = (width, max(1, round(height * width / full)))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        K = scale_intrinsics(torch.from_numpy(K), (full, height), size).numpy()
    return View(grey, K, np.asarray(world_T_cam, np.float64))


def depth_of(views: Sequence[View], i: int, settings: StereoSettings = SETTINGS) -> np.ndarray:
    """Depth of view i by those before it.

    Returns:
        float32 [2, h, w]: metres, and how sure that is (0..1); zero throughout if no view can be
        compared.
    """
    poses = np.stack([view.world_T_cam for view in views[: i + 1]])
    sources = choose_sources(poses, i, settings.sources, settings.baseline)
    return stereo_depth(views[i], [views[j] for j in sources], settings)


def scores_of(view: View, sources: Sequence[View], settings: StereoSettings) -> np.ndarray:
    """How well a view matches others of its size at each plane, float32 [P, h, w] in -1..1."""
    return sweep(view, sources, settings.inverse, settings.window, settings.best)


def stereo_depth(view: View, sources: Sequence[View], settings: StereoSettings) -> np.ndarray:
    """Depth of a view by others of its size; see `depth_of`."""
    if not sources:
        return np.zeros((CHANNELS, *view.grey.shape), np.float32)
    scores = torch.from_numpy(scores_of(view, sources, settings))[None]
    with torch.inference_mode(), torch.autocast("cpu", enabled=False):  # as in training's maps
        maps = read_depth(shipped_regularizer()(scores), torch.from_numpy(settings.inverse).float())
    return torch.cat(maps).numpy()
