"""Colours of a growing mesh, chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
import trimesh

from tf_lab.errors import TFLabError
from tf_lab.evaluation.truth import Truth
from tf_lab.meshes.colors import color_vertices
from tf_lab.meshes.glb import vertex_colors
from tf_lab.meshes.raycast import CLAY
from tf_lab.online.kept import best_frames
from tf_lab.support.colors import error_colors, frame_colors
from tf_lab.viewer.growth import Growth

FRAMES = 24  # that paint a chunk, evenly chosen of those that see it
MODES = ("image", "best view", "error", "clay")
AROUND = 0.1  # metres; what lies so near to a ray may hide its end, for images are coarse
SPARSE = 3  # every so many of the other chunks' vertices hide what is behind them


def by_images(growth: Growth, piece: trimesh.Trimesh) -> np.ndarray:
    """As the frames see it: uint8 [V, 3]."""
    frames = growth.reconstructor.frames
    chosen = seeing(growth, piece.bounds)
    if not len(chosen):  # surface reaches a voxel's edge beyond what frames see
        return clay(piece)
    chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, FRAMES).round().astype(int))]
    poses = torch.stack([frames.poses[i][1] for i in chosen])
    between = _between(growth, piece, poses[:, :3, 3].cpu().numpy())
    others = [np.asarray(other.vertices)[::SPARSE] for other in between]
    painted = piece.copy()
    color_vertices(
        painted,
        [frames.images[i] for i in chosen],
        torch.stack([frames.poses[i][0] for i in chosen]),
        poses,
        occluders=np.concatenate([np.empty((0, 3)), *others]),
    )
    colors = vertex_colors(painted)
    assert colors is not None
    return colors


def _between(growth: Growth, piece: trimesh.Trimesh, centers: np.ndarray) -> list[trimesh.Trimesh]:
    """The other pieces that may lie between a piece and cameras at ``centers`` [N, 3]."""
    low = np.minimum(piece.bounds[0], centers.min(0)) - AROUND
    high = np.maximum(piece.bounds[1], centers.max(0)) + AROUND
    return [
        other
        for other in growth.pieces.values()
        if other is not piece and (other.bounds[1] > low).all() and (other.bounds[0] < high).all()
    ]


def by_best_view(growth: Growth, piece: trimesh.Trimesh, total: int) -> np.ndarray:
    """The frame of greatest weight at each vertex, as its colour along the trajectory."""
    best = best_frames(growth.reconstructor, np.asarray(piece.vertices))
    sources = np.array([*growth.sources, -1])  # the last: none
    return frame_colors(sources[best], total)


def by_error(truth: Truth, piece: trimesh.Trimesh) -> np.ndarray:
    """The distance of each vertex to the ground truth."""
    return error_colors(truth.distances(np.asarray(piece.vertices)))


def clay(piece: trimesh.Trimesh) -> np.ndarray:
    """One colour."""
    return np.tile(np.round(255 * np.array(CLAY)).astype(np.uint8), (len(piece.vertices), 1))


def painter(
    mode: str, growth: Growth, total: int, truth: Callable[[], Truth | None]
) -> Callable[[trimesh.Trimesh], np.ndarray]:
    """What gives pieces of a mesh their colours (uint8 [V, 3]) in a mode of `MODES`."""
    if mode == "image":
        return lambda piece: by_images(growth, piece)
    if mode == "best view":
        return lambda piece: by_best_view(growth, piece, total)
    if mode == "error":
        known = truth()
        if known is None:
            raise TFLabError("there is no ground truth: no error can be shown")
        return lambda piece: by_error(known, piece)
    if mode == "clay":
        return clay
    raise ValueError(f"{mode}: choose of {', '.join(MODES)}")


def seeing(growth: Growth, bounds: np.ndarray) -> np.ndarray:
    """Numbers of the frames whose frustum may touch the ball around a box [2, 3] (metres)."""
    planes = growth.reconstructor.frames.cameras["planes"].cpu().numpy()
    radius = np.linalg.norm(bounds[1] - bounds[0]) / 2
    inside = planes[..., :3] @ bounds.mean(0) + planes[..., 3]
    return np.flatnonzero((inside >= -radius).all(1))
