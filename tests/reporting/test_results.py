"""Reading finished runs, naming damaged ones, keeping small copies."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from helpers.made_up_runs import ROWS, SCENES, change_scores, scores, write_run
from tf_lab.errors import TFLabError
from tf_lab.evaluation.registry import METRICS, PAPER, MetricPart, metric_columns
from tf_lab.reporting.results import find_runs, keep_run, read_run, told_apart


def test_a_run(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "fusion=avg", 2, [0.5, 0.6, 0.7, 0.8], commit="abcdef0123456789")
    run = read_run(folder)
    assert (run.row, run.seed, run.directory) == ("Ours: w/o TRSF, avg", 2, folder)
    assert run.scenes == {s: scores(f) for s, f in zip(SCENES, (0.5, 0.6, 0.7, 0.8), strict=True)}
    assert [maker["commit"] for maker in run.makers] == ["abcdef0123456789"] * 2
    assert run.finished == 1e9


def test_a_run_of_other_metrics_is_a_run_of_the_same_study(tmp_path: Path) -> None:
    ours, other = (write_run(tmp_path, "", seed, [0.5, 0.6]) for seed in range(2))
    change_scores(other, "recall", normals=0.9)
    (run, plain), damaged = find_runs([other, ours])
    assert damaged == []
    assert {*run.scenes[SCENES[0]]} == {*scores(0)} - {"recall"} | {"normals"}
    assert run.settings == plain.settings


@dataclass(frozen=True)
class Reach:
    name: str = "reach"
    threshold: float = 0.1


def test_a_metric_by_other_settings_has_a_column_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    part = MetricPart("reach", "", Reach, heading="Reach", format=".1f", higher_is_better=False)
    monkeypatch.setitem(METRICS._parts, "reach", part)
    found = {"fscore": 0.5, "reach": 0.3}
    assert told_apart(found, {"reach": Reach()}) == found
    other = told_apart(found, {"reach": Reach(threshold=0.05)})
    assert other == {"fscore": 0.5, "reach (threshold=0.05)": 0.3}
    plain, column = metric_columns([*found, *other])[len(PAPER) :]
    assert (plain.heading, column.heading) == ("Reach", "Reach (threshold=0.05)")
    assert (column.format, column.higher_is_better) == (".1f", False)


@pytest.mark.parametrize(("row", "overrides"), ROWS.items())
def test_rows_are_told_from_the_config_and_share_their_settings(
    tmp_path: Path, row: str, overrides: str
) -> None:
    ours = read_run(write_run(tmp_path / "ours", "", 0, [0.5]))
    folder = write_run(tmp_path, overrides, 1, [0.6])
    run = read_run(folder.rename(tmp_path / "any name"))
    assert run.row == row
    assert run.settings == ours.settings


def test_how_to_make_a_damaged_run_anew(tmp_path: Path) -> None:
    """`runs` knows those of an output folder; of another, the folder is to go."""
    bad = write_run(tmp_path, "", 0, [0.5])
    for folder, command in ((tmp_path / "runs", "python -m tf_lab.runs rm"), (tmp_path, "rm -r")):
        path = bad.rename(folder / "one")
        (path / "metrics.json").write_text("{")
        with pytest.raises(TFLabError, match=f"to make it anew: {command} {path}"):
            read_run(path)
        bad = path


@pytest.mark.parametrize(
    "other",
    ["optimizer.steps=7", "data.size=3", "model.width=16", "resolution=0.04", "training.points=9"],
)
def test_what_else_differs_makes_runs_incomparable(tmp_path: Path, other: str) -> None:
    ours = read_run(write_run(tmp_path, "", 0, [0.5]))
    assert read_run(write_run(tmp_path, other, 0, [0.5])).settings != ours.settings


def test_an_encoder_of_ours_is_told_by_its_name(tmp_path: Path) -> None:
    """What is in its file tells two of one name apart; another's file has no name to go by."""
    given = "encoder.weights={} content.encoder=abc"
    for word, name in (("shipped", "shipped"), ("mine.safetensors", None)):
        run = read_run(write_run(tmp_path / word, given.format(word), 0, [0.5]))
        assert run.settings.get("encoder.weights") == name


def test_networks_that_are_only_tested_are_rows_of_one_study(tmp_path: Path) -> None:
    """A study's networks on a second test set: each run begins with another one."""

    def settings(steps: int) -> list[dict[str, Any]]:
        given = ("content.init=abc", "fusion=avg content.init=def")
        runs = [write_run(tmp_path, f"{o} optimizer.steps={steps}", 0, [0.5]) for o in given]
        return [read_run(run).settings for run in runs]

    tested, trained = settings(0), settings(10)
    assert tested[0] == tested[1]
    assert trained[0] != trained[1]  # trained on from other weights: no question of the row
    assert tested[0] != read_run(write_run(tmp_path, "optimizer.steps=10", 0, [0.5])).settings


def test_other_scenes_are_incomparable(tmp_path: Path) -> None:
    one = read_run(write_run(tmp_path / "a", "", 0, [0.5, 0.6]))
    other = read_run(write_run(tmp_path / "b", "", 0, [0.5, 0.6, 0.7]))
    assert one.settings != other.settings


def test_runs_are_found_in_several_folders(tmp_path: Path) -> None:
    write_run(tmp_path / "a", "", 0, [0.5])
    write_run(tmp_path / "b", "", 1, [0.5])
    (write_run(tmp_path / "b", "", 2, [0.5]) / "metrics.json").unlink()  # not finished
    runs, damaged = find_runs([tmp_path / "a" / "runs", tmp_path / "b"])
    assert sorted(run.seed for run in runs) == [0, 1]
    assert damaged == []


@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("metrics.json", '{"scenes": {', "damaged"),
        ("metrics.json", "[1]", "not a mapping"),
        (
            "metrics.json",
            '{"protocol": "x", "mean": {"acc": 1}, "scenes": {}}',
            "there is no scene",
        ),
        ("metrics.json", '{"protocol": "x", "mean": {"acc": 1}, "scenes": {"room": {}}}', "scene"),
        (
            "metrics.json",
            '{"protocol": "x", "mean": {"acc": 1}, "scenes": {"room": {"acc": "x"}}}',
            "scenes",
        ),
        (
            "metrics.json",
            '{"protocol": "x", "mean": {"acc": 1}, "scenes": {"room": null}}',
            "scenes",
        ),
        (
            "metrics.json",
            json.dumps({"mean": {"acc": 1}, "scenes": {"r": scores(float("nan"))}}),
            "not a finite number",
        ),
        ("config.yaml", "a: [", "damaged"),
        ("config.yaml", "", "not a mapping"),
        ("config.yaml", "seed: 0", "has other settings"),
        ("run.json", None, "missing"),
        ("run.json", "{", "damaged"),
    ],
)
def test_damaged_runs_are_named_and_left_out(
    tmp_path: Path, file: str, content: str | None, said: str
) -> None:
    write_run(tmp_path, "", 0, [0.5])
    bad = write_run(tmp_path, "", 1, [0.5])
    if content is None:
        (bad / file).unlink()
    else:
        (bad / file).write_text(content)
    runs, (line,) = find_runs([tmp_path])
    assert [run.seed for run in runs] == [0]
    assert str(bad / file) in line
    assert said in line
    assert len(line.splitlines()) == 1


def test_no_run_at_all(tmp_path: Path) -> None:
    with pytest.raises(
        TFLabError, match=r"no finished run in .*; run: python -m tf_lab\.train .*sweep="
    ):
        find_runs([tmp_path])
    with pytest.raises(TFLabError, match="no such folder"):
        find_runs([tmp_path / "absent"])
    (write_run(tmp_path, "", 1, [0.5]) / "run.json").write_text("{")
    with pytest.raises(TFLabError, match=r"no finished run.*run\.json: damaged"):
        find_runs([tmp_path])


def test_kept_copies_say_the_same_and_hold_no_place(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "select=rnd", 1, [0.5, 0.6])
    (folder / "meshes").mkdir()
    run = read_run(folder)
    kept = keep_run(run, tmp_path / "kept")
    assert kept == tmp_path / "kept" / folder.name
    assert sorted(path.name for path in kept.iterdir()) == [
        *("config.yaml", "metrics.json", "run.json")
    ]
    for path in kept.iterdir():
        assert str(tmp_path) not in path.read_text()
    copy = read_run(kept)
    assert (copy.row, copy.seed, copy.settings, copy.scenes) == (
        *(run.row, run.seed, run.settings, run.scenes),
    )
    assert [maker["commit"] for maker in copy.makers] == [maker["commit"] for maker in run.makers]
    origin = json.loads((kept / "run.json").read_text())
    assert origin["checkpoint"] == "trainings/tiny-seed0-abc/model.safetensors"
    assert origin["command"] == "python -m tf_lab.train select=rnd"
    optimizer = yaml.safe_load((kept / "config.yaml").read_text())["optimizer"]
    assert optimizer["lr"] == run.config.optimizer.lr
    before = (kept / "run.json").read_bytes()
    assert keep_run(read_run(kept), tmp_path / "kept") == kept  # onto itself
    assert (kept / "run.json").read_bytes() == before
