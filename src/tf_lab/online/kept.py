"""Which views speak for a point, and how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from tf_lab.geometry import FINE, invert_pose, project
from tf_lab.online.reconstructor import Reconstructor

MARK = 3  # pixels from the point to the frame drawn around it


@dataclass(frozen=True)
class KeptView:
    """One view that a voxel keeps.

    Attributes:
        source: the capture's frame.
        weight: of the attention; those of a voxel sum to 1.
        image: uint8 [H, W, 3], with the point marked.
    """

    source: int
    weight: float
    image: np.ndarray


@dataclass(frozen=True)
class Pick:
    """A point [3] (metres), the level asked, and the views kept there, of greatest weight first."""

    point: np.ndarray
    level: str
    views: tuple[KeptView, ...]

    @property
    def weights(self) -> np.ndarray:
        """Of the views, [N]."""
        return np.array([view.weight for view in self.views])


def best_frames(online: Reconstructor, points: np.ndarray) -> np.ndarray:
    """The frame of greatest weight at points [P, 3] (metres), by number: int [P]; -1: none."""
    voxels, which = np.unique(np.floor(np.asarray(points) / FINE), axis=0, return_inverse=True)
    frames, weights = online.view_weights((voxels + 0.5) * FINE)
    best = np.take_along_axis(frames, weights.argmax(1)[:, None], 1)[:, 0]
    return best[which.reshape(-1)]


def pick(online: Reconstructor, sources: Sequence[int], point: np.ndarray) -> Pick:
    """The views kept at a point: in its fine voxel, or, where there is none, in its coarse one.

    Args:
        online: the reconstruction.
        sources: the capture's frame behind each of its frames.
        point: [3], metres.
    """
    for level in ("fine", "coarse"):
        frames, weights = (x[0] for x in online.view_weights(point[None], level))
        held = np.flatnonzero(frames >= 0)
        if len(held):
            break
    order = held[np.argsort(-weights[held], kind="stable")]
    views = [
        KeptView(sources[frame], float(weight), _marked(online, int(frame), point))
        for frame, weight in zip(frames[order], weights[order], strict=True)
    ]
    return Pick(point, level, tuple(views))


def _marked(online: Reconstructor, frame: int, point: np.ndarray) -> np.ndarray:
    """A frame's image with a white and black square around a point (metres)."""
    image = online.frames.images[frame].permute(1, 2, 0).numpy().copy()
    K, pose = online.frames.poses[frame]
    uv, _ = project(torch.as_tensor(point).float()[None], K, invert_pose(pose))
    column, row = uv[0].round().long().tolist()
    for distance, value in ((MARK + 1, 0), (MARK, 255)):
        box = np.zeros(image.shape[:2], bool)
        inner = box.copy()
        _square(box, row, column, distance)[...] = True
        _square(inner, row, column, distance - 1)[...] = True
        image[box & ~inner] = value
    return image


def _square(image: np.ndarray, row: int, column: int, reach: int) -> np.ndarray:
    """The part of an image [H, W] within reach of a pixel."""
    rows = slice(max(row - reach, 0), max(row + reach + 1, 0))
    return image[rows, max(column - reach, 0) : max(column + reach + 1, 0)]
