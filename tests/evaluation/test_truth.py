"""Distances to a true surface: of a known mesh; points alone are no surface."""

import numpy as np
import pytest
import trimesh

from tf_lab.errors import TFLabError
from tf_lab.evaluation.truth import Truth


def test_distances_to_a_square() -> None:
    """Two by two metres on the floor; samples of it lie some 5 mm from each other."""
    corners = [[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    truth = Truth(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]))
    above, beside = [0.1, 0.2, 0.5], [1.3, 0.0, 0.4]
    found = truth.distances(np.array([above, beside]))
    np.testing.assert_allclose(found, [0.5, 0.5], atol=1e-3)
    np.testing.assert_array_equal(truth.distances(np.array([above]), most=0.1), [0.1])


def test_points_alone() -> None:
    with pytest.raises(TFLabError, match="has no faces"):
        Truth(trimesh.Trimesh(np.eye(3)))
