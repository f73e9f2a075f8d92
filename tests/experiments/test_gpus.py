"""A GPU for each job, without one: torch is told how many there are."""

import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from tf_lab.experiments import gpus

HOLD = """
import sys, time
from pathlib import Path
from tf_lab.experiments.gpus import reserved
with reserved(["0", "1"], Path(sys.argv[1])) as gpu:
    print(gpu, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def three(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("torch.cuda.device_count", lambda: 3)
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.delenv(gpus.VISIBLE, raising=False)


def test_each_job_takes_what_no_other_holds(tmp_path: Path) -> None:
    names = ["3", "MIG-GPU-8/1/0"]
    with ExitStack() as first, ExitStack() as second, ExitStack() as more:
        assert first.enter_context(gpus.reserved(names, tmp_path)) == names[0]
        assert second.enter_context(gpus.reserved(names, tmp_path)) == names[1]
        shared = [more.enter_context(gpus.reserved(names, tmp_path)) for _ in range(4)]
        assert shared == names * 2  # as evenly as can be
        second.close()
        with gpus.reserved(names, tmp_path) as gpu:
            assert gpu == names[1]
    with gpus.reserved(names, tmp_path) as gpu:
        assert gpu == names[0]


def test_a_job_that_was_killed_holds_none(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "0\n"
        with gpus.reserved(["0", "1"], tmp_path) as gpu:
            assert gpu == "1"
        process.kill()
    with gpus.reserved(["0", "1"], tmp_path) as gpu:
        assert gpu == "0"


@pytest.mark.usefixtures("three")
@pytest.mark.parametrize(
    ("given", "names"),
    [
        (None, ["0", "1", "2"]),
        ("5,GPU-a1,7", ["5", "GPU-a1", "7"]),
        ("5,6,7,-1,8", ["5", "6", "7"]),  # CUDA reads no further
    ],
)
def test_the_names_are_cudas(
    given: str | None, names: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if given is not None:
        monkeypatch.setenv(gpus.VISIBLE, given)
    assert gpus.visible() == names
    with gpus.one_gpu() as variables:
        assert variables == {gpus.VISIBLE: names[0]}


@pytest.mark.usefixtures("three")
@pytest.mark.parametrize("count", [0, 1])
def test_of_one_there_is_no_choice(
    count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.device_count", lambda: count)
    with gpus.one_gpu() as variables:
        assert variables == {}
    assert list(tmp_path.iterdir()) == []
