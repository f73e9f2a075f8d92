"""By how many frames a surface is seen, and by how many it only seems to be: what hides behind it.

Whether choosing views matters is a question of the scene: where every camera that points at a
surface also sees it, any choice will do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from tf_lab.data.capture import Capture
from tf_lab.data.groundtruth import DepthMaps
from tf_lab.data.scene import Scene
from tf_lab.geometry import in_view, invert_pose, project
from tf_lab.meshes.files import read_mesh
from tf_lab.support.layout import GROUNDTRUTH_MESH

REACH = 5.0  # metres that a frustum reaches
TOLERANCE = 0.05  # metres between a depth reading and the point that is seen there, at most


@dataclass(frozen=True)
class Visibility:
    """Of surface points: how many frames' frusta hold each, and how many of those see it; [V]."""

    candidates: np.ndarray
    seen: np.ndarray

    @property
    def share(self) -> float:
        """Of all views that a frustum promises, those that are true."""
        return float(self.seen.sum() / max(1, self.candidates.sum()))

    @property
    def median(self) -> float:
        """By how many frames the median point is seen."""
        return float(np.median(self.seen))


def measure_visibility(
    capture: Capture,
    frames: Sequence[int],
    points: np.ndarray,
    reach: float = REACH,
) -> Visibility:
    """Count views of surface points, told by the frames' depth.

    Args:
        capture: with depth.
        frames: indices of the frames to count.
        points: [V, 3] on the surface, metres.
        reach: how far (camera z, metres) a frustum goes.

    Raises:
        TFLabError: a frame has no depth.
    """
    where = torch.from_numpy(np.asarray(points)).float()
    candidates = torch.zeros(len(where), dtype=torch.int64)
    found = torch.zeros(len(where), dtype=torch.int64)
    for i, depth in zip(frames, DepthMaps(capture, frames), strict=True):
        pose = torch.from_numpy(capture.world_T_cam[i]).float()
        uv, z = project(where, torch.from_numpy(capture.K[i]).float(), invert_pose(pose))
        size = (depth.shape[1], depth.shape[0])
        held = in_view(uv, z, size, 0.05, reach).nonzero().squeeze(1)
        u, v = uv[held].round().long().unbind(-1)
        candidates[held] += 1
        found[held] += ((depth[v, u] - z[held]).abs() < TOLERANCE).long()
    return Visibility(candidates.numpy(), found.numpy())


def scene_visibility(scene: Scene, keyframes: Sequence[int], points: int = 20_000) -> Visibility:
    """Of some vertices of a scene's ground truth, seen by some of its frames."""
    vertices = np.asarray(read_mesh(scene.groundtruth / GROUNDTRUTH_MESH).vertices)
    every = max(1, len(vertices) // points)
    return measure_visibility(scene, keyframes, vertices[::every])
