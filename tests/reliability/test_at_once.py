"""Commands at the same time, in the same folder; and in surroundings that are not as usual."""

import subprocess
import sys
from pathlib import Path

import pytest

from helpers.faults import Case, results, undisturbed
from helpers.tiny_jobs import TINY, environment
from helpers.warm import Warm

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]
MINUTES = 1800.0


def begin(command: str, words: list[str], cwd: Path, name: str) -> Warm:
    return Warm(command, words, cwd, cwd / f"{name}.out", cwd / f"{name}.err")


@pytest.mark.parametrize("name", ["train", "prepare", "report", "evaluate", "reconstruct"])
def test_two_of_one_kind(name: str, cases: dict[str, Case], tmp_path: Path) -> None:
    case, together, alone = cases[name], tmp_path / "together", tmp_path / "alone"
    together.mkdir(), alone.mkdir()
    both = [begin(case.command, [*case.words(together)], tmp_path, str(i)) for i in range(2)]
    assert [one.wait(MINUTES) for one in both] == [0, 0]
    waited = ["waiting for" in (tmp_path / f"{i}.out").read_text() for i in range(2)]
    assert sum(waited) == (1 if name in ("train", "prepare") else 0)
    assert results(case, together) == results(case, undisturbed(case, alone))


def test_prepare_beside_a_training_on_the_same(cases: dict[str, Case], tmp_path: Path) -> None:
    case, together, alone = cases["prepare"], tmp_path / "together", tmp_path / "alone"
    together.mkdir(), alone.mkdir()
    words = [*case.words(together)]
    rooms = [w for w in TINY if not w.startswith("data.")]
    both = [
        begin("prepare", words, tmp_path, "prepare"),
        begin("train", [*words, *rooms, f"output={tmp_path / 'run'}"], tmp_path, "train"),
    ]
    assert [one.wait(MINUTES) for one in both] == [0, 0], (tmp_path / "train.err").read_text()
    assert results(case, together) == results(case, undisturbed(case, alone))


SURROUNDINGS = {
    "no HOME": {"HOME": None},
    "ASCII locale": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "no cache folder": {"TF_LAB_CACHE": None, "XDG_CACHE_HOME": None, "HOME": "nowhere"},
}


def run(case: Case, to: Path, **variables: str | None) -> subprocess.CompletedProcess[str]:
    """A command as a process of its own, from another working directory."""
    given = {name: value for name, value in {**environment(), **variables}.items() if value}
    return subprocess.run(
        [sys.executable, "-m", f"tf_lab.{case.command}", *case.words(to)],
        cwd="/",
        env=given,
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize("surroundings", SURROUNDINGS)
@pytest.mark.parametrize("name", ["reconstruct", "report"])
def test_surroundings(name: str, surroundings: str, cases: dict[str, Case], tmp_path: Path) -> None:
    to, alone = tmp_path / "Küche, 2", tmp_path / "alone"
    to.mkdir(), alone.mkdir()
    variables = dict(SURROUNDINGS[surroundings])
    if variables.get("HOME"):
        variables["HOME"] = str(tmp_path / "nowhere")
    done = run(cases[name], to, **variables)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert results(cases[name], to) == results(cases[name], undisturbed(cases[name], alone))
