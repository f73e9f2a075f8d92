"""Welding parts of known surfaces."""

import numpy as np
import pytest
import trimesh

from tf_lab.meshes.weld import Part, weld


def cut_sphere() -> tuple[trimesh.Trimesh, list[Part]]:
    """A sphere, and its faces in two parts, each with its own vertices."""
    sphere = trimesh.creation.icosphere(3)
    left = sphere.triangles_center[:, 0] < 0.1
    halves = [sphere.submesh([np.flatnonzero(side)])[0] for side in (left, ~left)]
    return sphere, [(np.asarray(half.vertices), np.asarray(half.faces)) for half in halves]


@pytest.mark.parametrize("tolerance", [0.0, 1e-5])
def test_halves_are_whole_again(tolerance: float) -> None:
    sphere, parts = cut_sphere()
    assert sum(len(v) for v, _ in parts) > len(sphere.vertices)
    vertices, faces = weld(parts, tolerance)
    whole = trimesh.Trimesh(vertices, faces, process=False)
    assert len(vertices) == len(sphere.vertices)
    assert whole.is_watertight
    assert whole.volume == pytest.approx(sphere.volume)


def test_what_is_not_quite_the_same_place() -> None:
    _, parts = cut_sphere()
    (vertices, faces), other = parts
    moved = [(vertices + 1e-8, faces), other]
    assert len(weld(moved)[0]) == len(vertices) + len(other[0])
    assert len(weld(moved, 1e-5)[0]) == len(weld(parts)[0])


def test_only_vertices_on_borders_are_merged() -> None:
    square = np.array([[0.0, 0, 0.5], [2, 0, 0.5], [2, 1, 0.5], [0.5, 1, 0.5]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    inner = [(square, faces), (square, faces)]  # only x = 0, x = 2, y = 0 are multiples of 2
    vertices, found = weld(inner, borders=2.0)
    assert len(vertices) == 5
    for triangle, expected in zip(vertices[found], square[np.tile(faces, (2, 1))], strict=True):
        np.testing.assert_array_equal(triangle, expected)


def test_collapsed_faces_go_and_one_part_stays() -> None:
    thin = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1e-7, 0], [0, 1, 0]])
    part = (thin, np.array([[0, 1, 2], [0, 2, 3]]))
    assert weld([part], 1e-5)[0] is thin
    far = (thin + 9, part[1])
    vertices, faces = weld([part, far], 1e-5)
    assert (len(vertices), len(faces)) == (6, 2)
