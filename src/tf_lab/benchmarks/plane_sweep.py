"""A classical baseline: plane-sweep stereo (Collins 1996), checked between views, fused to a TSDF.

Nothing is learned. Every keyframe's depth is swept over planes of equal steps in inverse depth,
scored by zero-mean normalised cross-correlation (ZNCC) with its best source views; depths that
other views do not confirm go; the rest is fused as depth of a sensor is.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from torch import Tensor

from tf_lab.data.capture import Capture
from tf_lab.data.keyframes import select_keyframes
from tf_lab.data.tsdf import bounds_of, extract_mesh, fuse_in_slabs, join
from tf_lab.errors import TFLabError
from tf_lab.geometry import VoxelGrid, invert_pose, pixel_directions, project, transform
from tf_lab.online.reconstruction import Reconstruction
from tf_lab.stereo.cost import View, sweep
from tf_lab.stereo.sources import choose_sources

log = logging.getLogger(__name__)

AT_ONCE = 12  # planes: what a sweep holds in memory grows with them


@dataclass(frozen=True)
class PlaneSweepSettings:
    """How depth is found and fused.

    Attributes:
        planes: between ``near`` and ``far`` (metres), of equal steps in inverse depth.
        sources: views that a keyframe is compared with, and ``best`` of them that count at a pixel:
            in the others it may be hidden.
        baseline: between two cameras, metres: the least, the most, and what is best.
        window: edge of the correlation's window, pixels.
        least: ZNCC that a depth needs.
        agree: other views that have to confirm a depth, each within ``tolerance`` of it (a share).
        voxel: edge, and ``truncation``, of the TSDF, metres.
    """

    planes: int = 96
    near: float = 0.4
    far: float = 5.0
    sources: int = 6
    best: int = 3
    baseline: tuple[float, float, float] = (0.05, 0.8, 0.25)
    window: int = 5
    least: float = 0.1
    agree: int = 1
    tolerance: float = 0.03
    voxel: float = 0.04
    truncation: float = 0.12


def plane_sweep(
    capture: Capture,
    keyframe_distance: float = 0.1,
    settings: PlaneSweepSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Reconstruction:
    """Reconstruct a capture from its keyframes by stereo; frames that can't be read are skipped.

    Args:
        capture: posed images.
        keyframe_distance: see `tf_lab.data.keyframes`; 0 takes every frame.
        settings: see `PlaneSweepSettings`.
        progress: called with (frames done, frames in all).

    Raises:
        TFLabError: no frame can be read.
    """
    s = settings or PlaneSweepSettings()
    views, skipped = _read(capture, select_keyframes(capture.world_T_cam, keyframe_distance))
    count = len(views.frames)
    depths = torch.zeros(count, *views.grey.shape[1:])
    for i in range(count):
        sources = views.sources(i, s)
        if sources:
            depths[i] = swept(views, i, sources, s)
        if progress is not None:
            progress(i + 1, count)
    kept = [checked(depths, views, i, s) for i in range(count)]
    return Reconstruction(_fused(kept, views, s), views.frames, skipped)


@dataclass(frozen=True)
class Views:
    """Keyframes: numbers, grey images [N, H, W] in 0..1, K [N, 3, 3], world_T_cam [N, 4, 4]."""

    frames: list[int]
    grey: Tensor
    K: Tensor
    world_T_cam: Tensor

    @property
    def size(self) -> tuple[int, int]:
        """(width, height), pixels."""
        return self.grey.shape[2], self.grey.shape[1]

    def __getitem__(self, i: int) -> View:
        """View i."""
        return View(*(part[i].numpy() for part in (self.grey, self.K, self.world_T_cam)))

    def sources(self, i: int, settings: PlaneSweepSettings) -> list[int]:
        """The views to compare view i with."""
        poses = self.world_T_cam.numpy()
        return choose_sources(poses, i, settings.sources, settings.baseline)


def _read(capture: Capture, keyframes: Sequence[int]) -> tuple[Views, list[str]]:
    images, used, skipped = [], [], []
    for i in keyframes:
        try:
            images.append(capture.image(i).astype(np.float32).mean(-1) / 255)
            used.append(i)
        except TFLabError as error:
            log.warning("frame %s skipped: %s", capture.frames[i], error)
            skipped.append(f"{capture.frames[i]}: {error}")
    if not used:
        first = skipped[0] if skipped else "there is none"
        raise TFLabError(f"{capture.name}: no keyframe can be read; the first: {first}")
    cameras = (torch.from_numpy(part[used]).float() for part in (capture.K, capture.world_T_cam))
    return Views(used, torch.from_numpy(np.stack(images)), *cameras), skipped


def swept(views: Views, i: int, sources: Sequence[int], settings: PlaneSweepSettings) -> Tensor:
    """Depth [H, W] (metres) of view i; 0 where no plane is good enough."""
    s, others = settings, [views[j] for j in sources]
    inverse = np.linspace(1 / s.far, 1 / s.near, s.planes, dtype=np.float32)
    parts = np.array_split(inverse, math.ceil(s.planes / AT_ONCE))
    scores = [sweep(views[i], others, part, s.window, s.best) for part in parts]
    best = torch.from_numpy(np.concatenate(scores))
    top, plane = best.max(0)
    depth = 1 / _between(best, plane, torch.from_numpy(inverse))
    border = (plane == 0) | (plane == s.planes - 1)
    return torch.where((top >= s.least) & ~border, depth, torch.zeros_like(depth))


def _between(scores: Tensor, plane: Tensor, inverse: Tensor) -> Tensor:
    """Inverse depth [H, W] at the peak of a parabola through the best plane and its neighbours."""
    around = [(plane + step).clamp(0, len(inverse) - 1)[None] for step in (-1, 0, 1)]
    left, middle, right = (scores.gather(0, index)[0] for index in around)
    curve = (left - 2 * middle + right).clamp(max=-1e-6)
    offset = (0.5 * (left - right) / curve).clamp(-0.5, 0.5)
    return inverse[plane] + offset * (inverse[1] - inverse[0])


def checked(depths: Tensor, views: Views, i: int, settings: PlaneSweepSettings) -> Tensor:
    """Depth [H, W] of view i of all depths [N, H, W] where enough other views confirm it."""
    s, size, depth = settings, views.size, depths[i]
    rays = pixel_directions(views.K[i], size) * depth[..., None]
    points = transform(views.world_T_cam[i], rays.flatten(0, 1))
    votes = torch.zeros(depth.numel())
    for j in views.sources(i, s):
        uv, z = project(points, views.K[j], invert_pose(views.world_T_cam[j]))
        u, v = uv.round().long().unbind(-1)
        inside = (z > 0) & (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])
        there = depths[j][v.clamp(0, size[1] - 1), u.clamp(0, size[0] - 1)]
        votes += inside & (there > 0) & ((there - z).abs() < s.tolerance * z)
    return torch.where((votes >= s.agree).view_as(depth), depth, torch.zeros_like(depth))


def _fused(depths: Sequence[Tensor], views: Views, s: PlaneSweepSettings) -> trimesh.Trimesh:
    """The mesh of depth maps; empty if there is no depth at all."""
    if not any(bool((depth > 0).any()) for depth in depths):
        return trimesh.Trimesh()
    K, poses = views.K, views.world_T_cam
    lower, upper = bounds_of(depths, K, poses, s.truncation + s.voxel, stride=1)
    grid = VoxelGrid.covering(lower.tolist(), upper.tolist(), s.voxel)
    slabs = fuse_in_slabs(depths, K, poses, grid, s.truncation, s.far)
    return join([extract_mesh(slab) for _, slab in slabs])
