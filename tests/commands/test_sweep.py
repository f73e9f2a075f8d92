"""Sweeps: trained once, every job a process of its own, restartable, with a table at the end."""

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.singleton import Singleton
from test_train import check_run
from tiny_jobs import Result, call

from tf_lab.commands import conf_dir, plain

Train = Callable[..., Result]
SIX = ("-m", "views=4,8,16", "select=rnd,attn")


@pytest.fixture
def jobs_in_process(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[list[str]]]:
    """Jobs run in this process, which is faster; their command lines."""
    commands: list[list[str]] = []

    def run(command: Sequence[str], log: Path, prefix: str) -> int:
        interpreter, flag, module, *arguments = command
        assert (interpreter, flag, module) == (sys.executable, "-m", "tf_lab.train")
        commands.append(arguments)
        hydra = Singleton.get_state()
        GlobalHydra.instance().clear()
        result = call("train", *arguments)
        Singleton.set_state(hydra)
        log.write_text(result.out + result.err)
        return result.status

    monkeypatch.setattr("tf_lab.jobs._run", run)
    yield commands


def table(result: Result) -> dict[tuple[str, int], str]:
    """The table that ends a sweep: F-score, or why it failed, by row and seed."""
    lines = result.out.splitlines()
    first = max(i for i, line in enumerate(lines) if line.startswith("job  row"))
    seed, score = lines[first].index("seed"), lines[first].index("F-score")
    return {
        (line[5:seed].strip(), int(line[seed:score])): line[score:]
        for line in lines[first + 1 :]
        if line[:3].strip().isdecimal()
    }


def records(output: Path) -> dict[str, dict[str, object]]:
    """What the runs in an output folder say, without how long they took."""
    found = {}
    for path in output.glob("runs/*/metrics.json"):
        metrics = json.loads(path.read_text())
        found[path.parent.name] = {k: metrics[k] for k in ("label", "mean", "scenes")}
    return found


def test_a_sweep_of_six_trains_once(
    train: Train, tmp_path: Path, jobs_in_process: list[list[str]]
) -> None:
    result = train(*SIX, f"output={tmp_path}")
    assert (result.status, result.err) == (0, "")
    runs = [path.parent for path in tmp_path.glob("runs/*/metrics.json")]
    labels = {check_run(run)["label"] for run in runs}
    assert len(runs) == len(labels) == 6
    assert len(list(tmp_path.glob("trainings/*"))) == 1
    assert len({json.loads((run / "run.json").read_text())["checkpoint"] for run in runs}) == 1
    assert len(jobs_in_process) == 6

    again = train(*SIX, f"output={tmp_path}")
    assert len(jobs_in_process) == 6  # no process more
    assert again.out.count("reusing the identical finished evaluation") == 6
    assert table(again) == table(result)
    assert {row for row, _ in table(again)} == labels
    for run in runs:
        metrics = json.loads((run / "metrics.json").read_text())
        assert table(again)[metrics["label"], 0] == f"{metrics['mean']['fscore']:.3f}"


@pytest.mark.usefixtures("jobs_in_process")
def test_a_failing_job_does_not_end_the_others(train: Train) -> None:
    result = train("-m", "views=0,4", "select=rnd")
    assert result.status == 1
    assert "Traceback" not in result.err + result.out
    failed, good = table(result)["Ours: 0 images, RND", 0], table(result)["Ours: 4 images, RND", 0]
    assert 0 <= float(good) <= 1
    reason, _, log = failed.partition(", see ")
    assert reason == "failed: exit status 2"
    assert "error: views=0: a voxel needs at least one view" in Path(log).read_text()
    assert "1 of 2 jobs failed" in result.out


def test_a_jobs_process_has_the_jobs_config(train: Train, monkeypatch: pytest.MonkeyPatch) -> None:
    configs, commands = [], []
    monkeypatch.setattr("tf_lab.train._finished", lambda cfg: configs.append(plain(cfg)))
    monkeypatch.setattr("tf_lab.jobs._run", lambda command, *_: commands.append(command) or 0)
    given = ("training.views=[1,2]", "output='a b=c'", "+trainer.max_time='1:2'")
    result = train("sweep=inputs", "seed=3,4", "row=avg,views8_rnd", *given, "hydra.verbose=false")
    assert result.status == 1
    assert set(table(result).values())
    composed = []
    for command in commands:
        with initialize_config_dir(conf_dir(), version_base="1.3"):
            composed.append(plain(compose("train", overrides=command[3:])))
    assert len(composed) == 4
    assert composed == configs[::2]  # asked before and after
    assert [(c["seed"], c["fusion"]["strategy"]) for c in composed] == [
        *((3, "avg"), (3, "transformer"), (4, "avg"), (4, "transformer")),
    ]
