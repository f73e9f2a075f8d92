"""Processes that end with the one that started them, whatever becomes of that."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tf_lab.support.processes import Children


def python(code: str, *arguments: object) -> list[str]:
    return [sys.executable, "-c", code, *map(str, arguments)]


def test_output_goes_to_the_log_and_to_the_screen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = "import sys; print('out'); print('errors too', file=sys.stderr); sys.exit(3)"
    assert Children().run(python(code), tmp_path / "log.txt", os.environ, "7: ") == 3
    assert (tmp_path / "log.txt").read_text() == "out\nerrors too\n"
    assert capsys.readouterr().out == "7: out\n7: errors too\n"


@pytest.mark.parametrize(
    ("code", "status"),
    [
        ("import sys; sys.exit(2)", 2),
        ("import os; os.kill(os.getpid(), 9)", -signal.SIGKILL),
        ("import os; assert os.environ['GIVEN'] == 'this'", 0),
    ],
)
def test_how_it_ended(code: str, status: int, tmp_path: Path) -> None:
    variables = {**os.environ, "GIVEN": "this"}
    assert Children().run(python(code), tmp_path / "log.txt", variables) == status


# holds a named pipe open as long as it lives; nobody listens to signals but the kernel
CHILD = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
import tf_lab
import os
assert "TF_LAB_PARENT" not in os.environ
alive = open(sys.argv[1], "w")
signal.pause()
"""

PARENT_PROCESS = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored, if the tests run behind
from pathlib import Path
from tf_lab.support.processes import Children
command = [sys.executable, "-c", sys.argv[1], sys.argv[2]]
Children().run(command, Path(sys.argv[2] + ".log"), os.environ)
"""


@pytest.mark.timeout(60)
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_child_ends_with_its_parent(end: signal.Signals, tmp_path: Path) -> None:
    pipe = tmp_path / "alive"
    os.mkfifo(pipe)
    parent = subprocess.Popen(python(PARENT_PROCESS, CHILD, pipe), stderr=subprocess.DEVNULL)
    with pipe.open() as alive:  # waits until the child opens it
        parent.send_signal(end)
        parent.wait()
        assert alive.read() == ""  # waits until the child is gone


@pytest.mark.timeout(60)
def test_all_children_are_ended_at_once_and_none_starts_any_more(tmp_path: Path) -> None:
    pipe = tmp_path / "alive"
    os.mkfifo(pipe)
    children, statuses = Children(), []

    def run() -> None:
        statuses.append(children.run(python(CHILD, pipe), tmp_path / "log.txt", os.environ))

    thread = threading.Thread(target=run)
    thread.start()
    with pipe.open():
        children.terminate()
        thread.join()
    assert statuses == [-signal.SIGTERM]
    with pytest.raises(KeyboardInterrupt):
        children.run(python(""), tmp_path / "log.txt", os.environ)
