"""Sweeps: the table that ends one, how its jobs ended, and launchers that cannot work here."""

from pathlib import Path

import pytest
from hydra._internal.utils import get_args_parser

from tf_lab.errors import TFLabError
from tf_lab.experiments import launcher
from tf_lab.experiments.launcher import JOB


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


@pytest.mark.parametrize(
    ("status", "reason"),
    [(2, "exit status 2"), (-9, "killed by SIGKILL"), (0, "left no result")],
)
def test_how_a_job_ended(status: int, reason: str) -> None:
    assert launcher._reason(status) == reason


def test_a_launcher_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(launcher.LAUNCHERS, "slurm", "no-such-package")
    with pytest.raises(TFLabError, match=r"launcher=slurm .* pip install no-such-package"):
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
