"""A user whom the system does not know, with no home; folders that cannot be written to."""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from helpers.faults import Case, lines, results, undisturbed
from helpers.tiny_jobs import environment

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]
UNKNOWN = 12345
READS = "+dac_read_search"  # so that it may read Python, wherever that is
AS_UNKNOWN = (
    *("setpriv", f"--reuid={UNKNOWN}", f"--regid={UNKNOWN}", "--clear-groups"),
    *(f"--inh-caps={READS}", f"--ambient-caps={READS}", "env", "--unset=HOME"),
)


@pytest.fixture(autouse=True)
def can_become_another() -> None:
    if shutil.which("setpriv") is None or subprocess.run([*AS_UNKNOWN, "true"]).returncode:
        pytest.skip("needs setpriv, and a process that may use it: root")


def run(
    case: Case, words: Sequence[str], cwd: Path, **variables: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*AS_UNKNOWN, sys.executable, "-m", f"tf_lab.{case.command}", *words],
        cwd=cwd,
        env=environment(**variables),
        capture_output=True,
        text=True,
    )


def said(done: subprocess.CompletedProcess[str]) -> list[str]:
    """On standard error, but for what Matplotlib says of a home that is not there."""
    return [line for line in lines(done.stderr) if not line.startswith("Matplotlib created")]


def own_folder(path: Path) -> Path:
    path.mkdir()
    os.chown(path, UNKNOWN, UNKNOWN)
    return path


@pytest.mark.parametrize("name", ["train", "prepare", "evaluate", "report", "reconstruct"])
def test_an_unknown_user(name: str, cases: dict[str, Case], tmp_path: Path) -> None:
    """Of the scenes that are there; the cache belongs to another."""
    to, alone = own_folder(tmp_path / "to"), tmp_path / "alone"
    alone.mkdir()
    expected = results(cases[name], undisturbed(cases[name], alone))
    done = run(cases[name], cases[name].words(to), to)
    assert (done.returncode, said(done)) == (0, []), done.stderr
    assert results(cases[name], to) == expected


@pytest.mark.parametrize(
    "name",
    ["train", "sweep of 2 jobs", "prepare", "evaluate", "report", "reconstruct", "benchmark"],
)
def test_a_read_only_output(name: str, cases: dict[str, Case], tmp_path: Path) -> None:
    to = tmp_path / "to"
    to.mkdir()
    done = run(cases[name], cases[name].words(to), tmp_path)
    (line,) = said(done)
    assert (done.returncode, line.startswith(f"error: {to}")) == (2, True), line
    assert "Permission denied" in line
    assert list(to.iterdir()) == []


def test_a_read_only_cache(cases: dict[str, Case], tmp_path: Path) -> None:
    to, cache = own_folder(tmp_path / "to"), tmp_path / "cache"
    cache.mkdir()
    done = run(cases["train"], cases["train"].words(to), to, TF_LAB_CACHE=str(cache))
    (line,) = said(done)
    assert (done.returncode, line.startswith(f"error: {cache}/rooms-")) == (2, True), line
    assert "Permission denied" in line
