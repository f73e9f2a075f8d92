"""Sweeps: trained once, every job a process of its own, restartable, with a table at the end."""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from hydra.core.global_hydra import GlobalHydra
from hydra.core.singleton import Singleton

from helpers.run_directory import check_run
from helpers.tiny_jobs import TINY, Result, call, environment, start, tiny_config
from tf_lab.commands.train import finished, identified
from tf_lab.config.compose import compose_config
from tf_lab.config.schema import TrainConfig
from tf_lab.experiments.identity import training_directory
from tf_lab.experiments.launcher import JOB
from tf_lab.support.headers import read_info
from tf_lab.support.processes import Children

Train = Callable[..., Result]
SIX = ("-m", "views=4,8,16", "select=rnd,attn")


@pytest.fixture
def jobs_in_process(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[list[str]]]:
    """Jobs run in this process, which is faster; their command lines."""
    commands: list[list[str]] = []

    def run(_: Children, command: Sequence[str], log: Path, *__: object) -> int:
        interpreter, flag, module, *arguments = command
        assert (interpreter, flag, module) == (sys.executable, "-m", "tf_lab.train")
        commands.append(arguments)
        hydra = Singleton.get_state()
        GlobalHydra.instance().clear()
        result = call("train", *arguments)
        Singleton.set_state(hydra)
        log.write_text(result.out + result.err)
        return result.status

    monkeypatch.setattr(Children, "run", run)
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


def logs(output: Path) -> list[bool]:
    """Whether the log that a job's record names is there, of all jobs that name one."""
    jobs = [json.loads(path.read_text()) for path in output.glob("sweeps/*/*/job.json")]
    return [Path(job["log"]).is_file() for job in jobs if "log" in job]


@pytest.mark.long
def test_a_sweep_of_six_trains_once(
    train: Train, tmp_path: Path, jobs_in_process: list[list[str]]
) -> None:
    result = train(*SIX, f"output={tmp_path}")
    assert (result.status, result.err) == (0, ""), result.out
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
    assert logs(tmp_path) == [True] * 6  # what is reused has none
    for run in runs:
        metrics = json.loads((run / "metrics.json").read_text())
        assert table(again)[metrics["label"], 0] == f"{metrics['mean']['fscore']:.3f}"


@pytest.mark.usefixtures("jobs_in_process")
def test_a_failing_job_does_not_end_the_others(
    train: Train, main_job: Result, outputs: Path
) -> None:
    """Weights to start from, that only one of them can take."""
    weights = outputs.parent / main_job.path("training") / "model.safetensors"
    result = train("-m", "fusion=transformer,avg", f"init={weights}")
    assert result.status == 1
    assert "Traceback" not in result.err + result.out
    good, failed = table(result)["Ours", 0], table(result)["Ours: w/o TRSF, avg", 0]
    assert 0 <= float(good) <= 1
    reason, _, log = failed.partition(", see ")
    assert reason.startswith("failed: ") and "of another network" in reason
    assert "of another network" in Path(log).read_text()
    assert "1 of 2 jobs failed" in result.out


def test_a_jobs_process_has_the_jobs_config(
    train: Train, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configs, commands = [], []

    def found(config: TrainConfig) -> Path:
        configs.append(config)
        return tmp_path

    monkeypatch.setattr("tf_lab.commands.train.run_directory", found)
    monkeypatch.setattr(Children, "run", lambda _, command, *__: commands.append(command) or 0)
    given = ("training.views=[1,2]", "+trainer.others.more='1:2'", "output=a, b=c")
    given += ("data.root=Küche ${x} (1)", "model.name=2024_01_01")
    result = train("sweep=inputs", "seed=3,4", "row=avg,views8_rnd", *given, "hydra.verbose=false")
    assert result.status == 1
    assert set(table(result).values())
    composed = []
    for command in commands:
        composed.append(identified(compose_config("train", *command[3:])))
    assert len(composed) == 4
    assert composed == configs[::2]  # asked before and after
    assert [(c.seed, c.fusion.strategy) for c in composed] == [
        *((3, "avg"), (3, "transformer"), (4, "avg"), (4, "transformer")),
    ]


@pytest.mark.parametrize(
    ("given", "seen"),
    [
        (("launcher.jobs=2",), {"0", "1"}),
        (("launcher.jobs=2", "trainer.devices=auto"), {None}),
        (("launcher.jobs=2", "trainer=ddp"), {None}),
        ((), {None}),
    ],
)
def test_jobs_of_a_machine_see_one_gpu_each(
    given: tuple[str, ...],
    seen: set[str | None],
    train: Train,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Unless they run on several, or one after the other."""
    found = []
    both = threading.Barrier(2 if given else 1)  # two jobs run at a time

    def run(_: Children, __: Sequence[str], ___: Path, variables: Mapping[str, str], *____) -> int:
        both.wait(60)
        found.append(variables.get("CUDA_VISIBLE_DEVICES"))
        both.wait(60)
        return 0

    monkeypatch.setattr(Children, "run", run)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 2)
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    result = train("-m", "seed=5,6", "launcher=local", *given, f"output={tmp_path}")
    assert set(found) == seen
    assert all(text.startswith("failed: left no result") for text in table(result).values())


def test_a_jobs_process_takes_the_launchers_words(train: Train) -> None:
    result = train("launcher=local", "launcher.jobs=2", "sweep=views", JOB)
    assert (result.status, result.err) == (0, "")
    assert "reusing the identical finished evaluation" in result.out


# a job's process stops for good after its first save, and holds a named pipe open till its end
STOP = """
import os, sys
if "TF_LAB_PARENT" in os.environ:
    import signal
    from tf_lab.training.fit import AtomicSaves
    save = AtomicSaves.save_checkpoint
    def save_and_stop(*arguments, **others):
        save(*arguments, **others)
        global alive
        alive = open({pipe!r}, "w")
        signal.pause()
    AtomicSaves.save_checkpoint = save_and_stop
"""


def kill_while_jobs_train(arguments: Sequence[str], folder: Path) -> None:
    """Start a sweep, and kill it when a job has saved; returns when that has ended, too."""
    folder.mkdir()
    pipe = folder / "alive"
    os.mkfifo(pipe)
    (folder / "sitecustomize.py").write_text(STOP.format(pipe=str(pipe)))
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    with (folder / "output.txt").open("w") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "tf_lab.train", *arguments],
            env=environment(PYTHONPATH=path),
            stdout=output,
            stderr=output,
        )
    with pipe.open() as alive:
        process.kill()
        process.wait()
        assert alive.read() == ""  # waits until all have ended that opened it


@pytest.mark.long
@pytest.mark.usefixtures("outputs")
def test_jobs_side_by_side_end_with_a_killed_sweep(tmp_path: Path) -> None:
    sweep = ["-m", *TINY, "seed=0,1", "launcher=local", "launcher.jobs=2"]
    kill_while_jobs_train([*sweep, f"output={tmp_path}"], tmp_path / "stopped")
    assert not list(tmp_path.glob("trainings/*/model.safetensors"))


@pytest.mark.long
@pytest.mark.usefixtures("outputs")
def test_a_killed_sweep_goes_on_to_the_same_results(
    tmp_path: Path, jobs_in_process: list[list[str]]
) -> None:
    """By processes of their own, and by the same command."""
    sweep = ["-m", *TINY, "row=ours,views4", "optimizer.steps=40"]
    killed = [*sweep, f"output={tmp_path / 'killed'}"]
    training = training_directory(tiny_config("optimizer.steps=40", killed[-1]))
    kill_while_jobs_train(killed, tmp_path / "stopped")
    assert (training / "last.ckpt").exists()
    assert not (training / "model.safetensors").exists()

    result = call("train", *killed)
    assert (result.status, result.err) == (0, "")
    assert len(read_info(training / "model.safetensors")["training"]["sessions"]) == 2
    undisturbed = call("train", *sweep, f"output={tmp_path / 'undisturbed'}")
    assert table(result) == table(undisturbed)
    assert records(tmp_path / "killed") == records(tmp_path / "undisturbed")
    assert len(records(tmp_path / "killed")) == 2


@pytest.mark.slow
@pytest.mark.usefixtures("outputs")
@pytest.mark.timeout(1800)
def test_a_sweep_killed_twice_ends_as_an_undisturbed_one(tmp_path: Path) -> None:
    sweep = ["-m", *TINY, "row=ours,avg,no_ray", "optimizer.steps=40"]
    killed = [*sweep, f"output={tmp_path / 'killed'}"]
    for number in range(2):
        kill_while_jobs_train(killed, tmp_path / f"stopped{number}")
    results = [start("train", *killed, cwd=tmp_path)]
    results.append(start("train", *sweep, f"output={tmp_path / 'undisturbed'}", cwd=tmp_path))
    assert [result.status for result in results] == [0, 0]
    assert table(results[0]) == table(results[1])
    assert records(tmp_path / "killed") == records(tmp_path / "undisturbed")
    began = time.monotonic()
    assert table(start("train", *killed, cwd=tmp_path)) == table(results[0])
    assert time.monotonic() - began < 20  # a promise of the README's


@pytest.mark.slow
@pytest.mark.usefixtures("outputs")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "launcher",
    [("launcher=local", "launcher.jobs=2"), ("hydra/launcher=submitit_local",)],
    ids=["local", "submitit"],
)
def test_jobs_side_by_side(launcher: Sequence[str], tmp_path: Path) -> None:
    """Two jobs of one training: one trains, the other waits for it; one job fails."""
    long = "optimizer.steps=200"  # the other has started before the training ends
    result = start("train", "-m", *TINY, long, "views=4,8,0", *launcher, cwd=tmp_path)
    assert result.status == 1
    scores = table(result)
    assert 0 <= float(scores["Ours: 4 images", 0]) <= 1
    assert 0 <= float(scores["Ours: 8 images", 0]) <= 1
    assert scores["Ours: 0 images", 0].startswith("failed: views=0")
    assert len(list(tmp_path.glob("outputs/trainings/*"))) == 1
    logs = [path.read_text() for path in tmp_path.glob("outputs/sweeps/*/*/log.txt")]
    assert len(logs) == 3
    good = [log for log in logs if "error: views=0" not in log]  # that one may come first or last
    assert len(good) == 2
    assert sum("reusing the identical finished training" in log for log in good) == 1
    assert sum("waiting for process " in log for log in good) == 1


@pytest.mark.slow
@pytest.mark.usefixtures("outputs")
@pytest.mark.timeout(1800)
def test_a_sweep_of_distributed_trainings(tmp_path: Path) -> None:
    """Each job starts its helpers, trains, tests and has a folder of its own."""
    ddp = ("trainer.devices=2", "trainer.strategy=ddp")
    result = start("train", "-m", *TINY, "row=ours,avg", *ddp, cwd=tmp_path)
    assert result.status == 0, result.out + result.err
    assert [float(score) >= 0 for score in table(result).values()] == [True, True]
    for log in tmp_path.glob("outputs/sweeps/*/*/log.txt"):
        assert "GLOBAL_RANK: 1, MEMBER: 2/2" in log.read_text()
    for run in tmp_path.glob("outputs/runs/*"):
        check_run(run)
    assert len(list(tmp_path.glob("outputs/trainings/*/model.safetensors"))) == 2


def test_without_a_test_scene_a_training_is_all_that_a_job_has_to_do(tmp_path: Path) -> None:
    config = tiny_config("data.test_size=0", f"output={tmp_path}")
    training = training_directory(config)
    assert finished(config) is None
    training.mkdir(parents=True)
    (training / "model.safetensors").touch()
    assert finished(config) == training
    assert finished(replace(config, data=replace(config.data, test_size=1))) is None
