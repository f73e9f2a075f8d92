"""The paper's figures: what they show is what is known, and what there is not is told."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from matplotlib.figure import Figure
from PIL import Image

from helpers.online.scenes import FAR, FRAMES, balanced, reconstruct
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.geometry import FINE
from tf_lab.meshes import raycast
from tf_lab.meshes.files import read_mesh
from tf_lab.online.kept import best_frames
from tf_lab.online.reconstruction import Reconstruction
from tf_lab.reporting import paper
from tf_lab.reporting.figures import meshes, views
from tf_lab.reporting.figures.catalog import FIGURES, draw_figures
from tf_lab.reporting.figures.contract import Compared, Material, Shown
from tf_lab.reporting.figures.rooms import room
from tf_lab.reporting.figures.runtimes import runtimes
from tf_lab.support.colors import frame_colors, weight_colors

BENCHMARK = Path(__file__).resolve().parents[2] / "results" / "benchmark" / "benchmark.json"
SIZE = (80, 60)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rough pictures."""
    monkeypatch.setattr(raycast, "AMBIENT_RAYS", 1)
    monkeypatch.setattr(raycast, "FINE", 1)
    monkeypatch.setattr(views, "MAP", (160, 120))


@pytest.fixture(scope="module")
def shown(tiny_network: Callable[..., Any], box_scene: Path) -> Shown:
    """Six frames of the box room."""
    scene = Scene(box_scene)
    online = reconstruct(balanced(tiny_network(far=FAR), scene), scene, FRAMES, resolution=0.1)
    result = Reconstruction(online.mesh(), list(FRAMES), [], online)
    return Shown(scene, result, read_mesh(scene.groundtruth / "mesh_gt.ply"))


@pytest.fixture(scope="module")
def runtime() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(BENCHMARK.read_text())
    return found


def images(figure: Figure) -> list[np.ndarray]:
    """Of all axes, in the order in which they were made."""
    axes = [a for part in [figure, *_parts(figure)] for a in part.axes]
    return [np.asarray(a.images[0].get_array()) for a in dict.fromkeys(axes) if a.images]


def _parts(figure: Any) -> list[Any]:
    return [deeper for part in figure.subfigs for deeper in (part, *_parts(part))]


def texts(figure: Any) -> list[str]:
    """Titles and labels."""
    import matplotlib.text

    return [t.get_text() for t in figure.findobj(matplotlib.text.Text) if t.get_text()]


def floor(height: float) -> trimesh.Trimesh:
    """A floor of 2 x 2 m at a height, that faces up."""
    corners = [[0, 0, height], [2, 0, height], [2, 2, height], [0, 2, height]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def wall() -> trimesh.Trimesh:
    """One metre high, so that a cut takes nothing of the floor."""
    corners = [[0, 2, 0], [2, 2, 0], [2, 2, 1], [0, 2, 1]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def test_best_views(shown: Shown) -> None:
    drawn = views.best_views(shown)
    picture, *examples = images(drawn.figure)
    assert (picture < 250).any() and "frame along the trajectory" in texts(drawn.figure)
    online, mesh = shown.result.online, shown.result.mesh
    assert online is not None
    points = (np.floor(np.asarray(mesh.vertices) / FINE) + 0.5) * FINE
    frames, weights = online.view_weights(points)
    best = frames[np.arange(len(points)), weights.argmax(1)]
    np.testing.assert_array_equal(best_frames(online, np.asarray(mesh.vertices)), best)
    # each colour in the map is a frame's, darker by its shadow
    hues = frame_colors(np.array([*FRAMES, -1]), len(shown.capture.frames)) / 255
    there = picture.reshape(-1, 3)[(picture < 250).any(-1).reshape(-1)] / 255
    unit = [x / np.linalg.norm(x, axis=1, keepdims=True) for x in (there, hues)]
    assert (unit[0] @ unit[1].T).max(1).min() > 0.999
    for axes in drawn.figure.axes:
        if axes.get_title().startswith("frame "):
            frame = int(axes.get_title().split(":")[0].split()[1])
            expected = frame_colors(np.array([frame]), len(shown.capture.frames))[0] / 255
            np.testing.assert_allclose(axes.spines["left"].get_edgecolor()[:3], expected)
            np.testing.assert_array_equal(axes.images[0].get_array(), shown.capture.image(frame))
    assert len(examples) > 1


def test_selected_views(shown: Shown) -> None:
    online = shown.result.online
    assert online is not None
    points = np.asarray(shown.result.mesh.vertices)
    held = (online.view_weights(points)[0] >= 0).sum(1)
    chosen = points[[int(held.argmax()), int(held.argmin())]]
    assert held.max() > 1
    figure = views.selected_views(shown, chosen).figure
    for part, point in zip(figure.subfigs, chosen, strict=True):
        frames, weights = (x[0] for x in online.view_weights(point[None]))
        expected = sorted(zip(weights, frames, strict=True), reverse=True)
        shown_views = [a for a in part.subfigs[1].axes if a.images]
        said = [axes.get_title().split(": ") for axes in shown_views]
        assert sum(float(weight) for _, weight in said) == pytest.approx(1, abs=0.002)
        kept = [(w, FRAMES[f]) for w, f in expected if f >= 0]
        assert [int(frame) for frame, _ in said] == [frame for _, frame in kept]
        assert [w for _, w in said] == [f"{w:.3f}" for w, _ in kept]
        colors = weight_colors(np.array([w for w, _ in kept])) / 255
        edges = [axes.spines["left"].get_edgecolor()[:3] for axes in shown_views]
        np.testing.assert_allclose(edges, colors)
    assert "weight" in texts(figure)
    with pytest.raises(TFLabError, match=r"no view is kept at \(90.00, "):
        views.selected_views(shown, np.array([[90.0, 0, 0]]))


def test_points_are_chosen_where_views_are(shown: Shown) -> None:
    figure = views.selected_views(shown).figure
    assert len(figure.subfigs) == views.POINTS
    for part in figure.subfigs:
        assert len([axes for axes in part.subfigs[1].axes if axes.images]) > 1


def test_an_inset_is_the_part_in_the_frame() -> None:
    K = np.array([[50.0, 0, 39.5], [0, 50, 29.5], [0, 0, 1]])
    corner = (12, 7)
    zoomed = meshes.zoomed(K, corner)
    ray = np.array([0.2, -0.1, 1.0])
    there, inset = (K @ ray)[:2], (zoomed @ ray)[:2]
    # edges of pixels, not centres, are what is scaled
    np.testing.assert_allclose(inset + 0.5, (there + 0.5 - np.array(corner)) * meshes.INSET)
    panels = [np.full((60, 80, 3), 200, np.uint8) for _ in range(3)]
    panels[1][40:45, 60:66] = 0
    (x, y) = meshes.differing(panels, SIZE)
    assert x <= 60 and x + 80 / meshes.INSET >= 65 and y <= 40 and y + 60 / meshes.INSET >= 44


def test_comparison() -> None:
    truth = floor(0) + wall()
    scene = Compared("a", {"Stereo": floor(0.05), "Ours": truth}, truth, {"Ours": 0.5})
    figure = meshes.comparison([scene, scene], SIZE).figure
    for part in figure.subfigs:
        titles = [axes.get_title() for axes in part.axes if axes.get_title()]
        assert titles == ["Stereo", "Ours\nF 0.500", "Ground truth"]
        stereo, ours, there = (axes.images[0].get_array() for axes in part.axes[:3])
        np.testing.assert_array_equal(ours, there)  # the same mesh by the same camera
        assert (np.asarray(stereo) != ours).any() and (np.asarray(ours) < 250).any()
        assert [len(axes.lines) for axes in part.axes[:3]] == [1, 1, 1]
        assert part.get_supylabel() == "a"
    nothing = Compared("a", {"Ours": trimesh.Trimesh()}, None)
    with pytest.raises(TFLabError, match="all meshes are empty"):
        meshes.comparison([nothing], SIZE)


def test_errors_are_in_centimetres() -> None:
    truth = floor(0) + wall()
    scene = Compared("a", {"Ours": floor(0.05)}, truth)
    drawn = meshes.errors(scene, SIZE)
    found = texts(drawn.figure)
    assert "cm" in found  # at the colour bar
    (above, below) = (axes for axes in drawn.figure.axes if axes.images and axes.get_xlabel())
    assert float(above.get_xlabel().split()[1]) == pytest.approx(5, abs=0.15)
    whole = float(below.get_xlabel().split()[1])  # the wall is far from the floor
    assert 4.8 < whole < 60
    with pytest.raises(TFLabError, match="all meshes are empty"):
        meshes.errors(Compared("a", {"Ours": trimesh.Trimesh()}, truth), SIZE)
    with pytest.raises(TFLabError, match="without ground truth"):
        meshes.errors(Compared("a", {"Ours": truth}, None), SIZE)


def test_a_room_from_above_and_inside(shown: Shown) -> None:
    assert shown.truth is not None
    perfect = Reconstruction(shown.truth, list(FRAMES), [], None)
    figure = room(Shown(shown.capture, perfect, shown.truth), 80).figure
    pictures = images(figure)
    assert len(pictures) == 9
    for picture in pictures:
        assert picture.std() > 5
    for row in (1, 2):  # through the same camera, the same mesh
        np.testing.assert_array_equal(pictures[3 * row + 1], pictures[3 * row + 2])
    assert {"from above", "Image", "Ground truth"} <= set(texts(figure))


def test_runtimes(runtime: dict[str, Any]) -> None:
    speed, frame, _, size = runtimes(runtime).figure.axes
    assert (speed.get_yscale(), speed.get_ylabel()) == ("log", "frames a second")
    heights = [[bar.get_height() for bar in bars] for bars in speed.containers]
    expected = [
        [runtime["frame"][f"{m} {k}"]["fps"] for k in (4, 8, 16)] for m in ("lazy", "eager")
    ]
    np.testing.assert_allclose(heights, [*expected, [paper.FPS[k] for k in (4, 8, 16)]])
    legend = speed.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["lazy", "eager", "paper"]
    total = np.sum([[bar.get_height() for bar in bars] for bars in frame.containers], axis=0)
    np.testing.assert_allclose(total, 100, rtol=1e-6)
    assert (frame.get_ylabel(), size.get_xlabel()) == ("% of the time", "rooms")


def test_what_cannot_be_drawn_is_told(tmp_path: Path, runtime: dict[str, Any]) -> None:
    def missing() -> Any:
        raise TFLabError("there are no runs")

    material = Material(missing, missing, missing, missing, lambda: runtime)
    files, left_out = draw_figures(["runtimes", "fscore_k", "errors"], material, tmp_path)
    assert [path.name for path in files] == ["runtimes.png", "runtimes.pdf"]
    assert left_out == ["no fscore_k, errors: there are no runs"]
    with Image.open(tmp_path / "runtimes.png") as picture:
        assert np.asarray(picture.convert("L")).std() > 10
    assert "model=paper, 640x480" in (tmp_path / "runtimes.txt").read_text()


def test_their_names() -> None:
    from tf_lab.config import schema

    assert tuple(FIGURES) == schema.FIGURES
    with pytest.raises(TFLabError, match=r"figures=\[nope\]: there is no such figure; there are v"):
        schema.check_figures(["views", "nope"])
