"""Pictures of the same room under every row."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from matplotlib.figure import Figure

from helpers.made_up_runs import change_scores, write_run
from tf_lab.errors import TFLabError
from tf_lab.reporting import gallery
from tf_lab.reporting.gallery import draw_scene, scene_runs
from tf_lab.reporting.studies import Study, open_study

ROOM = "room_2000000"


def box(width: float) -> trimesh.Trimesh:
    return trimesh.creation.box((2, width, 1))


@pytest.fixture
def study(tmp_path: Path) -> Study:
    """Seed 0 has one row with a mesh, seed 1 has three."""
    for seed, overrides, width in (
        *((0, "", 1.0), (0, "views=4", None)),
        *((1, "views=4", 0.5), (1, "", 1.0), (1, "fusion=avg", 0.0)),
    ):
        run = write_run(tmp_path, overrides, seed, [0.5 + 0.1 * seed])
        if width is not None:
            (run / "meshes").mkdir()
            mesh = box(width) if width else trimesh.Trimesh()
            mesh.export(run / "meshes" / f"{ROOM}.ply")
    return open_study([tmp_path])[0]


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    figures: list[Figure] = []
    monkeypatch.setattr(gallery, "write_figure", lambda figure, *_: figures.append(figure))
    return figures


def test_the_seed_with_the_most_rows_is_shown(study: Study) -> None:
    runs = scene_runs(study, ROOM)
    assert [*runs] == ["Ours", "Ours: w/o TRSF, avg", "Ours: 4 images"]
    assert {run.seed for run in runs.values()} == {1}
    assert scene_runs(study, "elsewhere") == {}


def test_a_panel_a_row(study: Study, drawn: list[Figure], tmp_path: Path) -> None:
    draw_scene(scene_runs(study, ROOM), ROOM, box(1.0), tmp_path / "a.png", size=(60, 45))
    (figure,) = drawn
    panels = {axes.get_title(): axes.images[0].get_array() for axes in figure.axes if axes.images}
    assert [title.split("\n") for title in panels] == [
        *(["Ground truth"], ["Ours", "F 0.600"]),
        *(["Ours: w/o TRSF, avg", "F 0.600"], ["Ours: 4 images", "F 0.600"]),
    ]
    truth, ours, empty, other = (np.asarray(image) for image in panels.values())
    np.testing.assert_array_equal(truth, ours)  # the same mesh by the same camera
    assert (empty == 255).all()
    assert (other != ours).any() and (other < 250).any()


def test_a_run_without_the_fscore_has_none_in_its_title(
    study: Study, drawn: list[Figure], tmp_path: Path
) -> None:
    change_scores(study.runs["Ours", 1].directory, "fscore")
    again = open_study([tmp_path])[0]
    draw_scene(scene_runs(again, ROOM), ROOM, None, tmp_path / "a.png", size=(60, 45))
    assert next(axes.get_title() for axes in drawn[0].axes if axes.images) == "Ours"


def test_without_ground_truth(study: Study, drawn: list[Figure], tmp_path: Path) -> None:
    draw_scene(scene_runs(study, ROOM), ROOM, None, tmp_path / "a.png", size=(60, 45))
    assert len([axes for axes in drawn[0].axes if axes.images]) == 3


def test_nothing_to_draw(study: Study, tmp_path: Path) -> None:
    empty = {"Ours: w/o TRSF, avg": study.runs["Ours: w/o TRSF, avg", 1]}
    with pytest.raises(TFLabError, match="all meshes are empty"):
        draw_scene(empty, ROOM, None, tmp_path / "a.png")
