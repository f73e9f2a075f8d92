"""Only runs that may be compared share a study."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from helpers.made_up_runs import ROWS, SCENES, write_run, write_study
from tf_lab.config.compose import compose_config
from tf_lab.config.stored import portable_config
from tf_lab.errors import TFLabError
from tf_lab.reporting.report import describe
from tf_lab.reporting.results import keep_run, read_run
from tf_lab.reporting.studies import open_study

HALF = [0.5, 0.6, 0.7, 0.8]


def test_rows_seeds_and_scores(tmp_path: Path) -> None:
    write_run(tmp_path, "", 1, HALF)
    write_run(tmp_path, "", 0, [0.1, 0.2, 0.3, 0.4])
    write_run(tmp_path, "fusion=avg", 1, HALF)
    write_run(tmp_path, "refine=false views=4", 0, HALF)  # no row of the paper
    study, remarks = open_study([tmp_path])
    assert remarks == []
    assert study.rows == ["Ours: w/o TRSF, avg", "Ours", "Ours: w/o spatial ref., 4 images"]
    assert study.missing == [row for row in ROWS if row not in ("Ours", "Ours: w/o TRSF, avg")]
    assert study.scenes == [*SCENES]
    assert study.seeds() == study.seeds("Ours") == [0, 1]
    assert study.seeds("Ours", "Ours: w/o TRSF, avg") == [1]
    assert study.seeds("Ours: w/o view ray") == []
    np.testing.assert_allclose(study.scores("Ours"), [[0.1, 0.2, 0.3, 0.4], HALF])
    np.testing.assert_allclose(study.scores("Ours", "prec", [1]), [np.array(HALF) + 0.04])
    assert study.scores("Ours: w/o view ray").shape == (0, 4)


def test_all_rows_come_in_the_papers_order(tmp_path: Path) -> None:
    runs = write_study(tmp_path, dict.fromkeys(reversed(ROWS), 0.6), seeds=[0])
    assert open_study([runs])[0].rows == [*ROWS]


def test_other_rows_come_by_their_names_with_numbers_as_numbers(tmp_path: Path) -> None:
    for views in (16, 8, 4):
        write_run(tmp_path, f"select=diverse views={views}", 0, HALF)
    names = [f"Ours: {views} images, diverse (ours)" for views in (4, 8, 16)]
    assert open_study([tmp_path])[0].rows == names


def test_studies_are_kept_apart(tmp_path: Path) -> None:
    write_study(tmp_path, {"Ours": 0.6, "Ours: 4 images": 0.5})
    write_run(tmp_path, "optimizer.steps=7 data.size=3", 0, HALF)
    write_run(tmp_path, "resolution=0.04", 0, HALF)
    study, remarks = open_study([tmp_path])
    assert len(study.runs) == 6
    assert len(remarks) == 2
    assert all(len(line.splitlines()) == 1 for line in remarks)
    (one,) = [line for line in remarks if "optimizer.steps" in line]
    size, steps = study.settings["data.size"], study.settings["optimizer.steps"]
    assert f"data.size 3 (not {size}), optimizer.steps 7 (not {steps})" in one
    (two,) = [line for line in remarks if "resolution" in line]
    assert "1 run, with test.resolution 0.04 (not 0.02)" in two
    # the one asked for, by the key that the remark gives
    other, _ = open_study([tmp_path], key=one.split()[3].rstrip(","))
    assert other.settings["optimizer.steps"] == 7
    with pytest.raises(TFLabError, match=rf"study=none: .*{study.key}"):
        open_study([tmp_path], key="none")


def test_scores_compare_of_the_same_scenes_and_rows(tmp_path: Path) -> None:
    write_study(tmp_path, {"Ours": 0.6, "Ours: 4 images": 0.5})
    write_run(tmp_path, "optimizer.steps=7", 0, HALF)
    write_run(tmp_path, "optimizer.steps=8 fusion=avg", 0, HALF)  # no row that the study has
    write_run(tmp_path, "optimizer.steps=9", 0, HALF[:3])  # of one scene less
    write_run(tmp_path, "data=flats", 0, HALF)  # of other scenes, although they are called the same
    study, remarks = open_study([tmp_path])
    assert [other.settings["optimizer.steps"] for other in study.others] == [7]
    told = [line for line in remarks if line.endswith("; its scores are in the table of settings")]
    assert len(remarks) == 4 and len(told) == 1 and "optimizer.steps 7" in told[0]


def test_scores_by_other_ground_truth_do_not_compare(tmp_path: Path) -> None:
    write_study(tmp_path, {"Ours": 0.6, "Ours: 4 images": 0.5})
    write_run(tmp_path, "content.groundtruth=abc", 0, HALF)
    study, remarks = open_study([tmp_path])
    assert (len(study.others), len(remarks)) == (0, 1)
    assert "scored by the ground truth given" not in describe(study)
    (key,) = re.findall(r"left out: study ([0-9a-f]+)", remarks[0])
    other, _ = open_study([tmp_path], key=key)
    assert "test scenes scored by the ground truth given" in describe(other)


def test_trainings_on_other_data_compare_by_the_same_test(tmp_path: Path) -> None:
    write_study(tmp_path, {"Ours": 0.6})
    write_run(tmp_path, "data=flats test_on=rooms", 0, HALF)
    assert len(open_study([tmp_path])[0].others) == 1


def test_of_parts_of_two_kinds_only_the_kind_is_told(tmp_path: Path) -> None:
    write_study(tmp_path, {"Ours": 0.6})
    write_run(tmp_path, "encoder=efficientnet_lite0 encoder.weights=rooms", 0, HALF)
    _, (line,) = open_study([tmp_path])
    assert "1 run, with encoder.name efficientnet_lite0 (not resnet); its scores" in line


def test_with_and_without_stereo_are_rows_of_one_study(tmp_path: Path) -> None:
    write_run(tmp_path, "", 0, HALF)
    write_run(tmp_path, "inputs=stereo content.stereo=abc", 0, HALF)
    study, remarks = open_study([tmp_path])
    assert (len(study.runs), remarks) == (2, [])


def test_of_the_same_row_and_seed_the_newest_counts(tmp_path: Path) -> None:
    write_run(tmp_path / "a", "", 0, [0.9], commit="aaaa", written=2e9)
    write_run(tmp_path / "b", "", 0, [0.1], commit="bbbb", written=1e9)
    study, (replaced, *mixed) = open_study([tmp_path])
    assert study.scores("Ours").tolist() == [[0.9]]
    assert "aaaa" in replaced and "bbbb" in replaced and "seed 0" in replaced
    assert mixed == []  # all that counts is of one commit


def test_a_copy_is_no_duplicate(tmp_path: Path) -> None:
    write_run(tmp_path / "a", "", 0, [0.9], written=2e9)
    write_run(tmp_path / "b", "", 0, [0.9], written=1e9)
    study, remarks = open_study([tmp_path / "a", tmp_path / "b"])
    assert (len(study.runs), remarks) == (1, [])


def test_of_a_run_and_its_kept_copy_the_run_counts(tmp_path: Path) -> None:
    """It has the meshes."""
    path = write_run(tmp_path / "a", "", 0, [0.9], written=1e9)
    keep_run(read_run(path), tmp_path / "report" / "runs")
    study, remarks = open_study([tmp_path])
    assert [run.directory for run in study.runs.values()] == [path]
    assert remarks == []


def test_what_is_half_removed_does_not_count(tmp_path: Path) -> None:
    write_run(tmp_path / "a", "", 0, [0.9])
    path = write_run(tmp_path / "b", "", 1, [0.1])
    path.rename(path.with_name(f".partial-host-1-{path.name}"))
    assert open_study([tmp_path])[0].seeds() == [0]


def test_of_tests_of_two_networks_in_one_row_the_newest_networks_count(tmp_path: Path) -> None:
    """A row's mean is not over seeds of different networks."""
    for seed in range(2):
        write_run(tmp_path / "a", "optimizer.steps=0 content.init=aaaa", seed, [0.5])
        write_run(tmp_path / "a", "optimizer.steps=0 content.init=aaab views=4", seed, [0.4])
    study, remarks = open_study([tmp_path / "a"])
    assert (len(study.runs), remarks) == (4, [])  # of each row one network: one study
    write_run(tmp_path / "b", "optimizer.steps=0 content.init=bbbb", 0, [0.9], written=2e9)
    study, remarks = open_study([tmp_path])
    np.testing.assert_allclose(study.scores("Ours"), [[0.9]])
    np.testing.assert_allclose(study.scores("Ours: 4 images"), [[0.4], [0.4]])
    one, two = remarks
    assert "seed 0" in one and "counts, the older" in one
    assert "seed 1" in two and "does not count" in two


def test_a_network_that_is_tested_again_counts_again(tmp_path: Path) -> None:
    """Another was tested in between; nothing of the newest test is left out."""
    for at, init in enumerate(("aaaa", "bbbb", "aaaa")):
        overrides = f"optimizer.steps=0 content.init={init}"
        write_run(tmp_path / str(at), overrides, 0, [0.5 + 0.1 * at], written=1e9 + at)
    study, remarks = open_study([tmp_path])
    np.testing.assert_allclose(study.scores("Ours"), [[0.7]])
    assert all("counts, the older" in remark for remark in remarks)


def test_networks_of_other_trainings_are_told_apart(tmp_path: Path) -> None:
    """A network that is only tested says how it was trained; none takes the place of another."""
    tested = {200: 0.5, 400: 0.9}
    for steps, score in tested.items():
        for seed in range(3 if steps == 200 else 1):
            init = f"optimizer.steps=0 content.init=a{steps + seed}"
            run = write_run(tmp_path / str(steps), init, seed, [score], written=1e9 + steps)
            origin = json.loads((run / "run.json").read_text())
            trained = compose_config("train", f"optimizer.steps={steps}", f"seed={seed}")
            origin["training"]["init"] = {"config": portable_config(trained)}
            (run / "run.json").write_text(json.dumps(origin))
    study, remarks = open_study([tmp_path])
    np.testing.assert_allclose(study.scores("Ours"), [[0.5]] * 3)
    assert [other.scores("Ours").tolist() for other in study.others] == [[[0.9]]]
    (line,) = remarks
    assert "with init.optimizer.steps 400 (not 200); its scores are in" in line


def test_each_seed_may_test_a_network_of_its_own(tmp_path: Path) -> None:
    """As of a study's trainings on other scenes."""
    for seed in range(2):
        write_run(tmp_path, f"optimizer.steps=0 content.init=a{seed}b", seed, [0.5])
    study, remarks = open_study([tmp_path])
    assert (study.seeds(), remarks) == ([0, 1], [])


def test_several_versions_of_the_code_are_said(tmp_path: Path) -> None:
    write_run(tmp_path, "", 0, [0.9], commit="aaaa")
    write_run(tmp_path, "", 1, [0.9], commit="bbbb-dirty")
    _, (line,) = open_study([tmp_path])
    assert "not all runs were made by the same code: commits aaaa and bbbb-dirty" in line


def test_commits_that_change_no_code_do_not_matter(tmp_path: Path) -> None:
    for seed, commit in enumerate(("aaaa", "bbbb")):
        run = write_run(tmp_path, "", seed, [0.9], commit=commit)
        origin = json.loads((run / "run.json").read_text())
        origin["code"] = origin["training"]["code"] = "the same"
        (run / "run.json").write_text(json.dumps(origin))
    assert open_study([tmp_path])[1] == []
