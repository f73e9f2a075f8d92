"""`python -m tf_lab.runs`: what is there, how far it is, and removing it."""

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from helpers.made_up_runs import change_scores
from helpers.tiny_jobs import TINY, Result, call, tiny_config
from tf_lab.commands.train import write_config
from tf_lab.experiments.provenance import commit, commits_of
from tf_lab.experiments.reuse import print_reuse, removal
from tf_lab.support.files import write_json
from tf_lab.support.locks import directory_lock


@pytest.fixture
def mine(main_job: Result, outputs: Path, tmp_path: Path) -> Path:
    """An output folder with the main job's training and evaluation."""
    for path in (main_job.path("training"), main_job.path("run")):
        shutil.copytree(outputs.parent / path, tmp_path / path)
    return tmp_path / "outputs"


def lines(*arguments: str) -> list[list[str]]:
    """The words of each line that the command prints."""
    result = call("runs", *arguments)
    assert (result.status, result.err) == (0, "")
    return [line.split("  ") for line in result.out.splitlines()]


def unfinished(output: Path, name: str) -> Path:
    directory = output / "trainings" / name
    directory.mkdir()
    write_config(tiny_config("seed=1", "fusion=avg"), directory / "config.yaml")
    return directory


def test_a_list_of_all(mine: Path, main_job: Result) -> None:
    names = ("one", "two", "one")
    sessions = [{"commit": n * 13, "code": n, "seconds": 90.0} for n in names]
    saved = {"global_step": 3, "callbacks": {"TrainingSessions": {"sessions": sessions}}}
    torch.save(saved, unfinished(mine, "half") / "last.ckpt")
    torch.save({"global_step": 3}, unfinished(mine, "bare") / "last.ckpt")
    write_json(unfinished(mine, "begun") / "run.json", {"commit": "three" * 8})
    write_json(mine / "trainings" / "half" / "run.json", {"commit": "three" * 8})
    (unfinished(mine, "broken") / "model.safetensors").write_bytes(b"damaged")
    out = call("runs").out
    trainings, runs, wrong = out.split("\n\n")
    assert wrong.startswith("cannot be read:\n")
    assert "broken/model.safetensors: damaged, or not a checkpoint" in wrong
    rows = {line.split()[0]: line for line in trainings.splitlines()[2:]}
    finished = rows.pop(main_job.path("training").name)
    assert "  finished  " in finished
    assert commits_of([{"commit": commit()}])[:9] in finished
    assert finished.endswith("  Ours / 0")
    cells = {name: re.split(" {2,}", row)[1:] for name, row in rows.items()}
    half = "unfinished at step 3 of 5"
    assert cells == {
        "half": [half, "oneoneone and twotwotwo and threethre", "rooms", "5", "4.5"],
        "bare": [half, "-", "rooms", "5", "-"],
        "begun": ["unfinished", "threethre", "rooms", "5", "-"],
        "broken": ["damaged", "-", "rooms", "5", "-"],
    }
    (line,) = runs.splitlines()[2:]
    assert line.startswith(main_job.path("run").name)
    fscore = next(x for x in main_job.out.splitlines() if x.startswith("Ours ")).split()[-1]
    assert line.endswith(f"  {fscore}    Ours / 0")


def test_what_is_known_of_one(mine: Path, main_job: Result) -> None:
    run, training = main_job.path("run").name, main_job.path("training").name
    for name in (run, run.rpartition("-")[2], str(mine / "runs" / run)):
        out = call("runs", "show", name).out
        assert "room_2000000" in out
        assert f'"checkpoint": "outputs/trainings/{training}/model.safetensors"' in out
    out = call("runs", "show", training).out
    assert '"command": "python -m tf_lab.train data.size=1 ' in out
    assert "\nconfig:\n" in out


def test_a_training_goes_with_its_evaluations(mine: Path, main_job: Result) -> None:
    run, training = main_job.path("run"), main_job.path("training")
    assert lines("rm", training.name) == [[f"removed {run}"], [f"removed {training}"]]
    assert list(mine.glob("*/*")) == []


def test_an_evaluation_goes_alone(mine: Path, main_job: Result) -> None:
    run, training = main_job.path("run"), main_job.path("training")
    assert lines("rm", str(run)) == [[f"removed {run}"]]
    assert list(mine.glob("*/*")) == [mine / "trainings" / training.name]


@pytest.mark.parametrize("given", [(), ("output=nowhere",)])
def test_a_directory_of_any_output_folder(
    mine: Path, main_job: Result, given: tuple[str, ...]
) -> None:
    """As ``removal`` prints it, wherever the output folder is."""
    elsewhere = mine.rename(mine.with_name("else where"))
    run = elsewhere / "runs" / main_job.path("run").name
    training = elsewhere / "trainings" / main_job.path("training").name
    *_, rm, directory = shlex.split(removal(training))
    assert lines(rm, directory, *given) == [[f"removed {run}"], [f"removed {training}"]]
    assert list(elsewhere.glob("*/*")) == []


def test_a_directory_that_one_is_in(
    mine: Path, main_job: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = main_job.path("run").name
    monkeypatch.chdir(mine / "runs")
    assert lines("rm", run) == [[f"removed {mine / 'runs' / run}"]]


def test_a_dry_run_says_what_would_go(mine: Path, main_job: Result) -> None:
    run, training = main_job.path("run"), main_job.path("training")
    before = sorted(mine.rglob("*"))
    would = [[f"would remove {run}"], [f"would remove {training}"]]
    assert lines("rm", "--dry-run", training.name) == would
    assert lines("rm", run.name, training.name, "--dry-run") == would  # each once
    assert sorted(mine.rglob("*")) == before
    assert len(lines("rm", run.name, training.name)) == 2
    assert list(mine.glob("*/*")) == []


def test_what_is_in_use_is_not_removed(mine: Path, main_job: Result) -> None:
    run, training = main_job.path("run"), main_job.path("training")
    with directory_lock(run, "evaluating"):
        result = call("runs", "rm", training.name)
        assert "works on it" in call("runs").out
    assert result.status == 2
    assert result.err.startswith(f"error: {run}: process ")
    assert (mine / "trainings" / training.name / "model.safetensors").exists()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("show", "nothing"), "error: nothing: no training or evaluation is called so in outputs"),
        (("show", "nothing"), "see python -m tf_lab.runs output=outputs"),
        (
            ("rm", "nothing", "output=x"),
            "error: nothing: no training or evaluation is called so in x",
        ),
        (("--output", "nowhere"), "error: nowhere: no trainings or evaluations in it"),
        (("output=nowhere",), "error: nowhere: no trainings or evaluations in it; give output=DIR"),
        (("show", "--dry-run", "x"), "show: takes no --dry-run"),
        (("list", "x"), "; usage: python -m tf_lab.runs [list | show NAME... | rm"),
        (("lsit",), "error: argument action: invalid choice: 'lsit'"),
        (("rm",), "rm: of which NAME?"),
        (("list", "x"), "list: takes no NAME"),
    ],
)
@pytest.mark.usefixtures("mine")
def test_bad_words(arguments: tuple[str, ...], expected: str) -> None:
    result = call("runs", *arguments)
    assert result.status == 2
    assert expected in result.err
    assert result.err.startswith("error: ") and result.err.count("\n") == 1


def test_what_is_known_of_an_unfinished_one(mine: Path) -> None:
    torch.save({"global_step": 3}, unfinished(mine, "half") / "last.ckpt")
    first = call("runs", "show", "half").out.splitlines()[0]
    row = "Ours: w/o TRSF, avg / 1"
    assert first == f"outputs/trainings/half: {row}, unfinished at step 3 of 5"


def test_what_has_just_begun_says_by_which_commit(
    train: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def begin(module: object, data: Callable[[], object], *_: object, **__: object) -> None:
        data()
        raise KeyboardInterrupt

    monkeypatch.setattr("tf_lab.commands.train.fit", begin)
    output = f"output={tmp_path / 'begun'}"
    assert train(output).status == 130
    row = call("runs", output).out.split("\n\n")[0].splitlines()[-1]
    made_by = commits_of([{"commit": commit()}])
    assert re.split(" {2,}", row)[1:] == ["unfinished", made_by, "rooms", "5", "-"]


def test_a_report_while_the_first_training_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody is sent into a sweep of hours for what only has to be waited for."""
    monkeypatch.chdir(tmp_path)
    assert "sweep=main_ablation" in call("report").err
    (tmp_path / "outputs" / "trainings").mkdir(parents=True)
    half = unfinished(tmp_path / "outputs", "half")
    torch.save({"global_step": 3}, half / "last.ckpt")
    result = call("report")
    assert result.status == 2
    said = "outputs/trainings/half is unfinished at step 3 of 5; it goes on by: "
    assert f"{said}the command that began it" in result.err
    write_json(half / "run.json", {"command": "python -m tf_lab.train seed=1 fusion=avg"})
    assert f"{said}python -m tf_lab.train seed=1 fusion=avg\n" in call("report").err
    with directory_lock(half, "training"):
        result = call("report")
    assert "works on it): report when it ends" in result.err
    assert "sweep" not in result.err


def test_as_a_process(mine: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tf_lab.runs", f"output={mine}"], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"{mine / 'trainings'}:\nTRAINING ")


def test_what_another_code_made_is_reused_and_said(
    mine: Path,
    main_job: Result,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    training = main_job.path("training")
    reused = f"reusing the identical finished training {training}\n"
    print_reuse("training", training)
    assert capsys.readouterr().out == reused
    monkeypatch.setattr("tf_lab.experiments.reuse.code_version", lambda: "another")
    print_reuse("training", training)
    first, note = capsys.readouterr().out.splitlines()
    assert first + "\n" == reused
    assert note.startswith(
        f"note: another code made it (commit {commits_of([{'commit': commit()}])}"
    )
    assert note.endswith(f"to make it anew: python -m tf_lab.runs rm {training}")


def test_a_run_without_an_fscore_is_finished(mine: Path, main_job: Result) -> None:
    """An older version's, say: what there is is shown, the rest is a dash."""
    run = mine / "runs" / main_job.path("run").name
    change_scores(run, "fscore")
    (line,) = [line for line in call("runs").out.splitlines() if line.startswith(run.name)]
    assert line.split("  ")[1] == "finished"
    assert line.endswith("  -        Ours / 0")
    shown = call("runs", "show", run.name).out
    row = next(line for line in shown.splitlines() if line.startswith("Ours ")).split()
    assert row[-1] == "-" and row[1] != "-"
    reused = call("train", *TINY)
    assert (reused.status, reused.err) == (0, "")
    assert "reusing the identical finished evaluation" in reused.out
    assert next(x for x in reused.out.splitlines() if x.startswith("Ours ")).split() == row
