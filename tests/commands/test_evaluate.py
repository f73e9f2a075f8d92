"""`python -m tf_lab.evaluate` on the published layout."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh

from helpers.tiny_jobs import Result, call, start, told
from tf_lab.meshes.files import read_mesh

METRICS = {"acc", "compl", "chamfer", "prec", "recall", "fscore"}
PUBLISHED = ("mesh_gt.ply", "occlusion_mask.npy", "world2grid.txt")


@pytest.fixture
def published(box_scene: Path, tmp_path: Path) -> Path:
    """predictions/ and groundtruth/ of two scenes: one predicted perfectly, one not at all."""
    for scene in ("scene0000_00", "scene0001_00"):
        directory = tmp_path / "groundtruth" / scene
        directory.mkdir(parents=True)
        for name in PUBLISHED:
            shutil.copy(box_scene / "groundtruth" / name, directory)
    (tmp_path / "predictions").mkdir()
    shutil.copy(
        box_scene / "groundtruth" / "mesh_gt.ply", tmp_path / "predictions/scene0000_00.ply"
    )
    return tmp_path


def test_jobs_of_a_sweep_write_a_file_each(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(published)
    given = ("predictions=predictions", "groundtruth=groundtruth", "output=m.json")
    result = call("evaluate", "-m", *given, "seed=0,1")
    assert result.status == 0, result.err
    assert sorted(path.name for path in published.glob("m*.json")) == ["m-0.json", "m-1.json"]


def test_by_a_process_on_the_published_layout(published: Path) -> None:
    result = start(
        *("evaluate", "predictions=predictions", "groundtruth=groundtruth", "output=new/m.json"),
        cwd=published,
    )
    assert result.status == 0, result.err
    metrics = json.loads((published / "new" / "m.json").read_text())
    assert metrics["protocol"] == "transformerfusion"
    perfect, absent = metrics["scenes"]["scene0000_00"], metrics["scenes"]["scene0001_00"]
    assert set(perfect) == set(absent) == set(metrics["mean"]) == METRICS
    assert perfect["fscore"] > 0.999
    assert perfect["compl"] < 1  # cm, to the nearest of 200k samples of some 35 square metres
    assert absent == {
        **{"acc": 100, "compl": 100, "chamfer": 100},
        **{"prec": 1, "recall": 0, "fscore": 0},
    }
    for key, value in metrics["mean"].items():
        assert value == pytest.approx((perfect[key] + absent[key]) / 2)
    rows = [line.split() for line in result.out.splitlines()]
    assert rows[0] == ["Scene", "Acc", "Compl", "Chamfer", "Prec", "Recall", "F-score"]
    assert ["mean", f"{metrics['mean']['acc']:.2f}"] == rows[4][:2]
    assert "no prediction, scored as empty: scene0001_00" in result.out


def test_predictions_of_other_names(published: Path) -> None:
    """None for a scene is a score of 0; none for any is another folder."""
    (published / "predictions" / "scene0000_00.ply").rename(
        published / "predictions" / "scene0000_00_mesh.ply"
    )
    result = call(
        *("evaluate", f"predictions={published / 'predictions'}"),
        f"groundtruth={published / 'groundtruth'}",
    )
    told(result, "no mesh of 2 scenes in", "scene0000_00.ply, but scene0000_00_mesh.ply")


def test_a_moved_prediction_scores_as_it_should(published: Path) -> None:
    """Five metres away every point is at the cap of one metre."""
    path = published / "predictions" / "scene0001_00.ply"
    mesh = read_mesh(published / "predictions" / "scene0000_00.ply")
    mesh.apply_translation([5, 0, 0])
    mesh.export(path)
    result = call("evaluate", "predictions=predictions", "groundtruth=groundtruth", "output=m.json")
    scores = json.loads(Path("m.json").read_text())["scenes"]["scene0001_00"]
    assert result.status == 0
    assert scores["compl"] == 100
    assert (scores["recall"], scores["fscore"]) == (0, 0)


def test_points_and_millimetres_are_told(published: Path) -> None:
    for scene, factor in (("scene0000_00", 1), ("scene0001_00", 1000)):
        mesh = read_mesh(published / "groundtruth" / scene / "mesh_gt.ply")
        points = trimesh.PointCloud(factor * mesh.vertices)
        points.export(published / "predictions" / f"{scene}.ply")
    result = call("evaluate", "predictions=predictions", "groundtruth=groundtruth", "output=m.json")
    assert result.status == 0
    *_, clouds, warning = result.out.splitlines()
    assert clouds == "no surface, scored by the points as they are: scene0000_00, scene0001_00"
    assert warning.startswith("warning: scene0001_00 is about 1000 times as large as the ground")
    metrics = json.loads(Path("m.json").read_text())
    assert metrics["scenes"]["scene0000_00"]["fscore"] > 0.99
    assert metrics["point_clouds"] == ["scene0000_00", "scene0001_00"]
    assert list(metrics["wrong_scale"]) == ["scene0001_00"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("groundtruth=groundtruth",), ("predictions is missing",)),
        (("predictions=predictions",), ("groundtruth is missing",)),
        ((), ("is missing",)),
        (("predictions=none", "groundtruth=groundtruth"), ("none: no such folder",)),
        (("predictions=predictions", "groundtruth=predictions"), ("predictions: no scene folder",)),
        (
            ("predictions=predictions", "groundtruth=."),
            (".: no ground truth in 2 folders of it, such as groundtruth", "<scene>/mesh_gt.ply"),
        ),
    ],
)
def test_wrong_arguments(
    published: Path, arguments: tuple[str, ...], expected: tuple[str, ...]
) -> None:
    result = call("evaluate", *arguments)
    assert result.status == 2
    (line,) = result.err.splitlines()
    assert line.startswith("error: ")
    for text in expected:
        assert text in line
    if "is missing" in line:
        assert "usage: python -m tf_lab.evaluate predictions=DIR groundtruth=DIR" in line


def test_a_forgotten_argument_by_a_process(tmp_path: Path) -> None:
    result = start("evaluate", cwd=tmp_path)
    assert result == Result(
        2,
        "",
        "error: predictions is missing; usage: python -m tf_lab.evaluate predictions=DIR "
        "groundtruth=DIR [output=FILE.json]\n",
    )


def damage_mesh(published: Path) -> Path:
    path = published / "predictions" / "scene0000_00.ply"
    path.write_bytes(path.read_bytes()[:-50])
    return path


def damage_matrix(published: Path) -> Path:
    path = published / "groundtruth" / "scene0000_00" / "world2grid.txt"
    path.write_text("1 2 3\n")
    return path


def remove_mask(published: Path) -> Path:
    path = published / "groundtruth" / "scene0000_00" / "occlusion_mask.npy"
    path.unlink()
    return path


@pytest.mark.parametrize("damage", [damage_mesh, damage_matrix, remove_mask])
def test_a_damaged_scene_is_named_and_the_others_are_scored(
    published: Path, damage: Callable[[Path], Path]
) -> None:
    path = damage(published)
    result = call("evaluate", "predictions=predictions", "groundtruth=groundtruth", "output=m.json")
    assert result.status == 2
    line = result.err.splitlines()[-1]
    assert line.startswith("error: 1 scene(s) left out of the mean: ")
    assert str(path.relative_to(published)) in line
    assert "Traceback" not in result.err
    assert list(json.loads(Path("m.json").read_text())["scenes"]) == ["scene0001_00"]


def test_further_metrics_are_asked_for_by_name(published: Path) -> None:
    words = ("predictions=predictions", "groundtruth=groundtruth", "output=m.json")
    result = call("evaluate", *words, "metrics=normals")
    heading, _, first, second, *_ = result.out.splitlines()
    assert heading.split()[-2:] == ["F-score", "Normals"]
    metrics = json.loads(Path("m.json").read_text())
    assert set(metrics["mean"]) == METRICS | {"normals"}
    assert metrics["scenes"]["scene0000_00"]["normals"] > 0.95  # the ground truth itself
    assert metrics["scenes"]["scene0001_00"]["normals"] == 0  # nothing at all
    assert (first.split()[-1][:3], second.split()[-1]) == ("0.9", "0.000")
    wrong = call("evaluate", *words, "metrics=typo")
    assert wrong.err == "error: metrics=typo: no such choice; there are normals\n"
