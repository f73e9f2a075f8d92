from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from tf_lab.errors import TFLabError
from tf_lab.evaluation import pictures
from tf_lab.evaluation.pictures import compare, error_colors
from tf_lab.meshes.raycast import CLAY, cast, overview_camera, render_mesh


def furnished_room() -> trimesh.Trimesh:
    """A room of 5 x 4 x 2.6 m: the shell seen from inside, a table, a bed, a shelf, a lamp."""
    shell = trimesh.creation.box((5, 4, 2.6))
    shell.invert()
    shell.apply_translation((2.5, 2, 1.3))

    def box(size: tuple[float, float, float], at: tuple[float, float, float]) -> trimesh.Trimesh:
        part = trimesh.creation.box(size)
        part.apply_translation(np.array(at) + np.array(size) * (0, 0, 0.5))
        return part

    legs = [box((0.08, 0.08, 0.7), (x, y, 0)) for x in (1.05, 2.15) for y in (1.2, 1.8)]
    furniture = [
        box((1.3, 0.8, 0.06), (1.6, 1.5, 0.7)),
        box((1.5, 2.0, 0.45), (4.2, 2.9, 0)),
        box((0.6, 0.4, 0.12), (4.2, 3.6, 0.45)),
        box((1.6, 0.4, 1.9), (1.2, 3.79, 0)),
        box((0.45, 0.45, 0.45), (1.6, 0.7, 0)),
        box((0.8, 0.8, 0.8), (4.5, 0.5, 0)),
    ]
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    ball.apply_translation((1.5, 1.5, 0.96))
    return sum([*legs, *furniture, ball], start=shell).subdivide_to_size(0.12)


def frontal(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """A camera at height 10 that looks straight down, 100 pixels a metre at height 0."""
    K = np.array([[1000.0, 0, (size[0] - 1) / 2], [0, 1000.0, (size[1] - 1) / 2], [0, 0, 1]])
    world_T_cam = np.diag([1.0, -1.0, -1.0, 1.0])
    world_T_cam[2, 3] = 10
    return K, world_T_cam


def square(half: float, height: float, up: bool = True) -> trimesh.Trimesh:
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + (0, 0, height)
    faces = [[0, 1, 2], [0, 2, 3]] if up else [[2, 1, 0], [3, 2, 0]]
    return trimesh.Trimesh(corners, faces, process=False)


def upright(y: float) -> trimesh.Trimesh:
    """A wall on the floor, 0.4 m wide and 1 m high, that faces smaller y."""
    corners = [[-0.2, y, 0], [0.2, y, 0], [0.2, y, 1], [-0.2, y, 1]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def covered(image: np.ndarray) -> np.ndarray:
    return np.asarray((image < 250).any(-1))


def test_a_square_falls_on_the_pixels_it_should() -> None:
    image = render_mesh(square(0.2, 0.0), *frontal((80, 60)), (80, 60))
    expected = np.zeros((60, 80), bool)
    expected[10:50, 20:60] = True  # 0.4 m at 100 pixels a metre, about the centre
    assert image.shape == (60, 80, 3) and image.dtype == np.uint8
    np.testing.assert_array_equal(covered(image), expected)


def test_hits_lie_on_the_surface() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.25)
    hits = cast(ball, *frontal((60, 60)), (60, 60))
    radius = np.linalg.norm(hits.points, axis=1)
    assert len(radius) > 5000 and radius.min() > 0.2485 and radius.max() < 0.25 + 1e-6
    assert (hits.points[:, 2] > 0).all()  # the near side
    corners = np.asarray(ball.vertices)[hits.triangles]
    assert np.linalg.norm(corners.mean(1) - hits.points, axis=1).max() < 0.03  # on their faces


def test_corners_are_darker() -> None:
    """A wall at y = 0.1 m on a floor: less ambient light reaches the floor at its foot."""
    wall = upright(0.1)
    floor, camera = square(0.2, 0.0), (*frontal((40, 40)), (40, 40))
    alone = render_mesh(floor, *camera).mean((1, 2))
    walled = render_mesh(floor + wall, *camera).mean((1, 2))
    assert np.ptp(alone) < 1  # a lone floor is evenly lit
    near, far = walled[10:13].mean(), walled[34:39].mean()  # y falls with the rows
    assert near < 0.85 * alone[20] and near < 0.95 * far < 0.95 * alone[20]


def test_only_what_is_within_reach_takes_light() -> None:
    """The floor ends at y = 0.2 m; a wall 0.4 m from its end does shade it, one 0.65 m not."""
    floor, camera = square(0.2, 0.0), (*frontal((40, 40)), (40, 40))
    alone = render_mesh(floor, *camera).astype(int)
    near, far = (render_mesh(floor + upright(0.2 + d), *camera) for d in (0.4, 0.65))
    assert (near[:3].mean() < alone[:3].mean() - 1) and (far == alone).all()


def test_far_from_the_worlds_origin_a_picture_is_the_same() -> None:
    room, (K, pose) = square(0.2, 0.0) + upright(0.1), frontal((40, 40))
    here, there = render_mesh(room, K, pose, (40, 40)), np.array([4e5, -5e6, 30.0])
    room.apply_translation(there)
    pose[:3, 3] += there
    far = render_mesh(room, K, pose, (40, 40))
    assert np.abs(here.astype(int) - far).mean() < 0.5


def test_faces_from_behind_and_above_the_cut_are_left_out() -> None:
    camera = (*frontal((40, 40)), (40, 40))
    assert not covered(render_mesh(square(0.2, 0.0, up=False), *camera)).any()
    room = square(0.1, 0.0) + square(0.2, 1.0)
    assert covered(render_mesh(room, *camera))[3, 3]
    below = render_mesh(room, *camera, ceiling=0.9)
    assert covered(below).sum() == 20 * 20  # only the lower, smaller one


def test_the_cut_goes_through_faces() -> None:
    """A tilted square that crosses the cut is seen up to the cut, not as whole faces."""
    tilted = trimesh.Trimesh(
        [[-0.1, -0.1, 0], [0.1, -0.1, 1], [0.1, 0.1, 1], [-0.1, 0.1, 0]],
        [[0, 1, 2], [0, 2, 3]],
        process=False,
    )
    hits = cast(tilted, *frontal((40, 40)), (40, 40), ceiling=0.5)
    assert hits.points[:, 2].max() == pytest.approx(0.5, abs=0.05)
    assert hits.points[:, 2].min() == pytest.approx(0, abs=0.05)


def test_the_overview_holds_the_whole_room_and_little_else() -> None:
    room = furnished_room()
    for turned in (False, True):
        if turned:
            room.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (0, 0, 1)))
        K, world_T_cam, ceiling = overview_camera(room.bounds, (320, 240))
        corners = trimesh.bounds.corners(room.bounds)
        corners[:, 2] = np.minimum(corners[:, 2], ceiling)
        camera = (corners - world_T_cam[:3, 3]) @ world_T_cam[:3, :3]
        pixels = (camera / camera[:, 2:]) @ K.T
        assert np.linalg.det(world_T_cam[:3, :3]) == pytest.approx(1)
        assert (pixels[:, :2] >= 0).all() and (pixels[:, :2] <= (319, 239)).all()
        extent = np.ptp(pixels[:, :2], axis=0) / (320, 240)
        assert extent.max() == pytest.approx(0.96)
        assert world_T_cam[2, 3] > room.bounds[1, 2]  # from above


def test_vertex_colors_show() -> None:
    red = np.tile(np.array([200, 0, 0], np.uint8), (4, 1))
    image = render_mesh(square(0.2, 0.0), *frontal((40, 40)), (40, 40), vertex_colors=red)
    assert image[20, 20, 0] > 100 and (image[20, 20, 1:] == 0).all()
    clay = render_mesh(square(0.2, 0.0), *frontal((40, 40)), (40, 40))[20, 20] / 255
    np.testing.assert_allclose(clay / clay[2], np.array(CLAY) / CLAY[2], atol=0.01)


def test_an_empty_mesh_is_a_white_picture() -> None:
    image = render_mesh(trimesh.Trimesh(), *frontal((40, 30)), (40, 30), ceiling=1.0)
    assert image.shape == (30, 40, 3) and (image == 255).all()


def test_the_error_is_of_the_prediction_to_the_ground_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A floor 8 cm too low above a true one: the second panel is the truth, the third of 8 cm."""
    drawn: list[Any] = []
    monkeypatch.setattr(pictures, "_compare_figure", lambda _, panels, title: drawn.append(panels))
    monkeypatch.setattr(pictures, "write_figure", lambda figure, path: None)
    truth, size = furnished_room(), (160, 120)
    moved = truth.copy()
    moved.apply_translation((0, 0, 0.08))
    half = truth.submesh([np.arange(0, len(truth.faces), 2)], append=True)
    for prediction in (truth, moved, half):
        compare(prediction, truth, [], tmp_path / "a.png", "room", size=size)
    exact, off, part = drawn
    assert [label for label, _ in exact] == [
        *("Prediction", "Ground truth", "Distance to ground truth")
    ]
    for panels in (off, part):
        assert np.array_equal(panels[1][1], exact[1][1])
        assert not np.array_equal(panels[0][1], exact[0][1])

    def hue(panel: np.ndarray) -> np.ndarray:
        """The mean colour of what is drawn, whatever its shade."""
        shown = panel[(panel < 250).any(-1)].astype(float)
        return np.median(shown / shown.max(-1, keepdims=True), axis=0)

    colors = error_colors(np.array([0.0, 0.08])) / 255
    right, wrong = (color / color.max() for color in colors)
    np.testing.assert_allclose(hue(exact[2][1]), right, atol=0.1)
    np.testing.assert_allclose(hue(part[2][1]), right, atol=0.1)
    assert np.abs(hue(off[2][1]) - right).max() > 0.2
    assert np.abs(right - wrong).max() > 0.2


def test_compare_writes_one_picture(tmp_path: Path) -> None:
    room, size = furnished_room(), (160, 120)
    frames = [np.full((12, 16, 3), 30 * i, np.uint8) for i in range(8)]
    moved = room.copy()
    moved.apply_translation((0, 0, 0.1))
    compare(moved, room, frames, tmp_path / "full.png", "room", fscore=0.5, size=size)
    compare(trimesh.Trimesh(), room, frames[:1], tmp_path / "empty.png", "room", 0.0, size)
    compare(room, None, [], tmp_path / "alone.png", "room", size=size)
    shapes = [np.asarray(Image.open(tmp_path / f"{n}.png")).shape for n in ("full", "alone")]
    assert shapes[0][1] > 2 * shapes[1][1]  # three panels and one
    assert {p.name for p in tmp_path.iterdir()} == {"full.png", "empty.png", "alone.png"}
    with pytest.raises(TFLabError, match=r"none\.png: there is no surface"):
        compare(trimesh.Trimesh(), None, frames, tmp_path / "none.png", "room")
