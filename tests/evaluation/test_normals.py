"""Normal consistency of surfaces whose normals are known."""

import numpy as np
import pytest
import trimesh

from tf_lab.evaluation.metrics import Comparison
from tf_lab.evaluation.normals import normal_consistency


def square(tilt: float, height: float = 0.0, n: int = 21) -> trimesh.Trimesh:
    """A unit square about the origin in n x n vertices, tilted by radians about the x axis."""
    axis = np.linspace(-0.5, 0.5, n)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1)
    faces = np.concatenate([np.stack([i, i + n, i + 1], 1), np.stack([i + n, i + n + 1, i + 1], 1)])
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(tilt, (1, 0, 0)))
    mesh.apply_translation((0, 0, height))
    return mesh


def consistency(
    mesh: trimesh.Trimesh, truth: trimesh.Trimesh, visible: np.ndarray | None = None
) -> float:
    points, faces = trimesh.sample.sample_surface(mesh, 500, seed=0)[:2]
    seen = np.ones(500, bool) if visible is None else visible
    found = Comparison(points, seen, np.asarray(truth.vertices), mesh, faces, truth)
    return normal_consistency(found)


@pytest.mark.parametrize("tilt", [0.0, 0.3, 1.0])
def test_it_is_the_cosine_of_the_tilt_whichever_way_faces_are_turned(tilt: float) -> None:
    mesh = square(tilt)
    assert consistency(mesh, square(0.0)) == pytest.approx(np.cos(tilt), abs=1e-6)
    mesh.invert()
    assert consistency(mesh, square(0.0)) == pytest.approx(np.cos(tilt), abs=1e-6)


def test_what_has_nothing_within_a_metre_has_none() -> None:
    assert consistency(square(0.0, height=3.0), square(0.0)) == 0
    both = trimesh.util.concatenate([square(0.0), square(0.0, height=3.0)])
    # half of the prediction is far away; all of the truth has its counterpart
    assert consistency(both, square(0.0)) == pytest.approx(0.75, abs=0.03)


def test_of_the_prediction_the_visible_points_count() -> None:
    both = trimesh.util.concatenate([square(0.0), square(0.0, height=3.0)])
    points, _ = trimesh.sample.sample_surface(both, 500, seed=0)[:2]
    assert consistency(both, square(0.0), points[:, 2] < 1) == pytest.approx(1)
