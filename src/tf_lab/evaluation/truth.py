"""How far points are from a true surface."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import cKDTree

SAMPLES = 200_000  # points on the ground truth


class Truth:
    """The ground truth: a mesh with faces, in metres, and distances to it."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.mesh = mesh
        points, _ = trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)
        self._tree = cKDTree(np.asarray(points))

    def distances(self, points: np.ndarray) -> np.ndarray:
        """From points [P, 3] to the surface: [P], metres."""
        return np.asarray(self._tree.query(points)[0])
