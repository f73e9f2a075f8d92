"""How far points are from a true surface."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from tf_lab.errors import TFLabError

SAMPLES = 200_000  # points on the ground truth


class Truth:
    """The ground truth: a mesh with faces, in metres, and distances to it.

    Raises:
        TFLabError: it has none.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        if not len(mesh.faces):
            raise TFLabError("the ground truth has no faces: a mesh is needed, not points alone")
        self.mesh = mesh
        points, _ = trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)
        self._tree = cKDTree(np.asarray(points))

    def distances(self, points: np.ndarray, most: float = np.inf) -> np.ndarray:
        """From points [P, 3] to the surface: [P], metres; larger ones as ``most``, sooner."""
        found, _ = self._tree.query(points, distance_upper_bound=most)
        return np.minimum(found, most)  # beyond the bound the tree answers infinity
