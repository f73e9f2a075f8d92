"""The process of a sweep's job: its output, how it ended, and that it ends with the sweep."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hydra._internal.utils import get_args_parser

from tf_lab.cli.overrides import JOB
from tf_lab.errors import TFLabError
from tf_lab.experiments import jobs

WAIT = "import time; print('started', flush=True); time.sleep(60)"


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_output_goes_to_the_log_and_to_the_screen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = "import sys; print('out'); print('errors too', file=sys.stderr); sys.exit(3)"
    assert jobs._run(python(code), tmp_path / "log.txt", "7: ") == 3
    assert (tmp_path / "log.txt").read_text() == "out\nerrors too\n"
    assert capsys.readouterr().out == "7: out\n7: errors too\n"


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import sys; sys.exit(2)", "exit status 2"),
        ("import os; os.kill(os.getpid(), 9)", "killed by SIGKILL"),
        ("", "left no result"),
    ],
)
def test_how_it_ended(code: str, reason: str, tmp_path: Path) -> None:
    assert jobs._reason(jobs._run(python(code), tmp_path / "log.txt", "")) == reason


def is_running(process: int) -> bool:
    """Whether a process is there, and not only because nobody has asked how it ended."""
    try:
        status = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_job_ends_with_its_sweep(end: signal.Signals, tmp_path: Path) -> None:
    job = """
import os, time
from tf_lab.experiments.jobs import PARENT, end_with_parent
end_with_parent()
assert PARENT not in os.environ
print(os.getpid(), flush=True)
time.sleep(60)
"""
    sweep = f"""
import sys
from pathlib import Path
from tf_lab.experiments.jobs import _run
_run([sys.executable, "-c", {job!r}], Path({str(tmp_path / "log.txt")!r}), "")
"""
    process = subprocess.Popen(
        python(sweep), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdout is not None
    child = int(process.stdout.readline())
    assert is_running(child)
    process.send_signal(end)
    process.wait()
    deadline = time.monotonic() + 10
    while is_running(child) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not is_running(child)


def test_without_a_sweep_it_just_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(jobs.PARENT, raising=False)
    jobs.end_with_parent()


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
    assert jobs.format_jobs(records) == (
        "job  row             seed  F-score\n"
        "  0  Ours               0  0.712\n"
        " 10  Ours: 4 images     1  failed: exit status 2, see b/log.txt\n"
        "1 of 2 jobs failed; the same command tries them again"
    )


def test_a_launcher_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(jobs.LAUNCHERS, "slurm", "no-such-package")
    with pytest.raises(TFLabError, match=r"launcher=slurm .* pip install no-such-package"):
        check("launcher=slurm")
    check("launcher=local")


def check(*words: str) -> None:
    jobs.check_launcher(get_args_parser().parse_args(words))


def test_slurms_launcher_needs_slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(TFLabError, match=r"^launcher=slurm: .* no srun here; start it on the "):
        check("-m", "launcher=slurm", "views=4,8")
    check("-m", "hydra/launcher=submitit_local", "views=4,8")
    check("--cfg=job", "launcher=slurm")
    check("launcher=slurm", JOB)  # in a container on a node
    (tmp_path / "srun").touch(mode=0o755)
    check("-m", "launcher=slurm", "views=4,8")
