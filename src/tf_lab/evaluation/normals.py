"""Normal consistency: does the surface face the way it should, wherever it is?"""

from __future__ import annotations

import numpy as np

from tf_lab.evaluation.metrics import Comparison, nearest


def normal_consistency(found: Comparison) -> float:
    """Mean |cos| between a point's normal and that of the nearest point of the other surface.

    The mean of both directions (Mescheder et al., Occupancy Networks, 2019); of the prediction the
    visible points count. A point without another within a metre has 0, and so has a point cloud.
    """
    if found.mesh is None or found.truth_mesh is None or found.faces is None:
        return 0.0
    of_prediction = np.asarray(found.mesh.face_normals)[found.faces]
    of_truth = np.asarray(found.truth_mesh.vertex_normals)
    there = _agreement(
        found.points[found.counted], of_prediction[found.counted], found.truth, of_truth
    )
    back = _agreement(found.truth, of_truth, found.points, of_prediction)
    return (there + back) / 2


def _agreement(
    points: np.ndarray, normals: np.ndarray, others: np.ndarray, their_normals: np.ndarray
) -> float:
    """Mean |cos| of the normals [P, 3] of points with those of the nearest others [Q, 3]."""
    _, index = nearest(points, others)
    padded = np.concatenate([their_normals, np.zeros((1, 3))])  # none in reach
    return float(np.abs((normals * padded[index]).sum(1)).mean())
