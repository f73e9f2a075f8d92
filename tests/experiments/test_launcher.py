"""Sweeps: the table that ends one, how its jobs ended, and launchers that cannot work here."""

import json
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from hydra._internal.utils import get_args_parser
from omegaconf import OmegaConf

from tf_lab.errors import TFLabError
from tf_lab.experiments import launcher
from tf_lab.experiments.launcher import JOB, SweepJobs
from tf_lab.support.processes import Children


def test_a_table_of_all_jobs() -> None:
    records = [
        {"job": 0, "row": "Ours", "seed": 0, "log": "a/log.txt", "fscore": 0.71234},
        {
            "job": 10,
            "row": "Ours: 4 images",
            "seed": 1,
            "log": "b/log.txt",
            "failed": "exit status 2",
            "fscore": None,
        },
    ]
    assert launcher.format_jobs(records) == (
        "job  row             seed  F-score\n"
        "  0  Ours               0  0.712\n"
        " 10  Ours: 4 images     1  failed: exit status 2, see b/log.txt\n"
        "1 of 2 jobs failed; the same command tries them again"
    )


def test_jobs_of_one_row_are_told_apart_by_their_settings() -> None:
    given = [("optimizer.lr=1e-3", 0), ("optimizer.lr=2e-3", 0), ("optimizer.lr=1e-3", 1)]
    records = [
        {"job": i, "row": "Ours", "seed": seed, "fscore": 0.5, "settings": ["x=1", rate]}
        for i, (rate, seed) in enumerate(given)
    ]
    assert launcher.format_jobs(records) == (
        "job  row                       seed  F-score\n"
        "  0  Ours (optimizer.lr=1e-3)     0  0.500\n"
        "  1  Ours (optimizer.lr=2e-3)     0  0.500\n"
        "  2  Ours                         1  0.500"
    )


@pytest.mark.parametrize(
    ("status", "log", "reason"),
    [
        (2, None, "exit status 2"),
        (1, "Traceback\nValueError: x\n", "exit status 1"),
        (2, "train 3/9\nerror: step 2: its numbers are not finite\n", "step 2: its numbers"),
        (2, "error: the cause\nerror: another process ended\n", "the cause"),
        (-9, "error: old", "killed by SIGKILL"),
        (0, "", "left no result"),
    ],
)
def test_how_a_job_ended(status: int, log: str | None, reason: str, tmp_path: Path) -> None:
    if log is not None:
        (tmp_path / "log.txt").write_text(log)
    assert launcher._reason(status, tmp_path / "log.txt").startswith(reason)


def test_a_launcher_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(launcher.LAUNCHERS, "slurm", ("no-such-package", "what-is-wanted"))
    with pytest.raises(
        TFLabError, match=r"^launcher=slurm needs no-such-package: pip install .* what-is-wanted$"
    ):
        check("launcher=slurm")
    check("launcher=local")  # is not asked for any


def check(*words: str) -> None:
    launcher.check_launcher(get_args_parser().parse_args(words))


def test_slurms_launcher_needs_slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(TFLabError, match=r"^launcher=slurm: .* no srun here; start it on the "):
        check("-m", "launcher=slurm", "views=4,8")
    check("-m", "hydra/launcher=submitit_local", "views=4,8")
    check("--cfg=job", "launcher=slurm")
    check("launcher=slurm", JOB)  # in a container on a node
    (tmp_path / "srun").touch(mode=0o755)
    check("-m", "launcher=slurm", "views=4,8")


def test_an_interrupted_sweep_ends_its_jobs_and_starts_no_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    jobs = SweepJobs("module", object, str, lambda config: None)
    composed = [
        OmegaConf.create({"trainer": {"devices": "auto"}, "hydra": {"job": {"num": number}}})
        for number in range(5)
    ]
    terminated, both, started = threading.Event(), threading.Barrier(2), []

    def run_job(jobs: SweepJobs, config: Any, hydra: Any, *_: Any) -> None:
        started.append(hydra.job.num)
        if hydra.job.num < 2:
            both.wait(60)
        if hydra.job.num == 0:
            raise KeyboardInterrupt
        assert terminated.wait(60)

    monkeypatch.setattr(launcher, "typed", lambda schema, cfg: cfg)
    monkeypatch.setattr(launcher, "run_job", run_job)
    monkeypatch.setattr(Children, "terminate", lambda self: terminated.set())
    with pytest.raises(KeyboardInterrupt):
        launcher.run_jobs(jobs, composed, 2)
    assert terminated.is_set()
    assert sorted(started)[:2] == [0, 1]
    assert len(started) < 5


def records(folder: Path, *jobs: tuple[int, str]) -> None:
    """The records of jobs, in folders of any depth."""
    for number, subdir in jobs:
        path = folder / subdir / launcher.RECORD
        path.parent.mkdir(parents=True, exist_ok=True)
        record = {"job": number, "row": f"Row {number}", "seed": 0, "fscore": 0.5, "log": "x"}
        path.write_text(json.dumps(record | ({"failed": "why"} if number == 9 else {})))


def test_the_table_is_of_this_sweep_wherever_its_jobs_lie(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = OmegaConf.create({"hydra": {"sweep": {"dir": str(tmp_path)}}})
    records(tmp_path, (9, "1"), (0, "0"))  # an earlier sweep's in the same folder
    table = launcher.JobTable()
    table.on_multirun_start(config)
    time.sleep(0.01)
    records(tmp_path, (0, "0"), (1, "views=4/seed=0"))
    table.on_multirun_end(config)  # none of this one failed
    lines = capsys.readouterr().out.strip().splitlines()
    assert [line.split()[0] for line in lines] == ["job", "0", "1"]
    table.on_multirun_start(config)
    records(tmp_path, (9, "new/9"))
    with pytest.raises(SystemExit):
        table.on_multirun_end(config)


def test_a_job_is_told_nothing_of_the_sweeps_folders() -> None:
    """Their names are made of what differs from job to job, which Hydra's grammar cannot read."""
    hydra = OmegaConf.create(
        {
            "job": {"override_dirname": "a=1,b=2"},
            "runtime": {"config_sources": []},
            "overrides": {
                "hydra": [
                    "hydra.mode=MULTIRUN",
                    "hydra.sweep.subdir=${hydra.job.override_dirname}",
                    "hydra.verbose=${oc.env:NO_SUCH,true}",
                ],
                "task": ["views=4", "data.root=${oc.env:HOME}"],
            },
        }
    )
    assert launcher.single_run(hydra) == [
        "hydra.verbose=${oc.env:NO_SUCH,true}",
        *("views=4", "data.root=${oc.env:HOME}", JOB),
    ]
