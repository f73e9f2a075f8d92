"""A signal ends a process with one line and a status, whatever it is at; its forks go with it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tf_lab.support import stops
from tf_lab.support.stops import PARENT, Stopped, as_parent, end_with_parent, stoppable

# does something until it is stopped; a named pipe says that it has begun, and that all are gone
STOPPABLE = """
import os, signal, sys, threading, time
from tf_lab.support.stops import stoppable, Stopped
def forked():
    if child := os.fork():
        return child
    signal.pause()
def endless():
    print("begun", file=alive, flush=True)
    time.sleep(99)
def swallows():
    while True:
        try:
            endless()
        except BaseException:
            pass
def lingers():
    threading.Thread(target=time.sleep, args=(99,)).start()
    endless()
def joins():  # as scipy does: what its threads work on must not be freed
    thread = threading.Thread(target=swallows, daemon=True)
    thread.start()
    try:
        thread.join()
    except BaseException:
        os._exit(99)
def imports():  # what would be cut off there is not Python's to tidy up
    class Finder:
        def find_spec(self, *_):
            swallows()
    sys.meta_path.insert(0, Finder())
    import nothing
def becomes_another():
    try:
        endless()
    except Stopped:
        raise ValueError
def hears_more():  # that a loader ended
    signal.signal(signal.SIGCHLD, lambda *_: None)
    try:
        endless()
    except Stopped:
        os.kill(child, signal.SIGKILL)
        time.sleep(0.2)
        raise
def finalises():  # where Python tells of exceptions, and goes on
    class Last:
        def __del__(self):
            endless()
    Last()
    time.sleep(99)
with stoppable("all is kept"):
    alive = open(sys.argv[1], "w")
    child = forked()
    globals()[sys.argv[2]]()
"""


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("number", "work", "quick"),
    [
        (signal.SIGINT, "endless", True),
        (signal.SIGTERM, "becomes_another", True),
        (signal.SIGTERM, "swallows", False),
        (signal.SIGHUP, "lingers", True),
        (signal.SIGTERM, "imports", True),
        (signal.SIGINT, "joins", True),
        (signal.SIGTERM, "finalises", True),
        (signal.SIGTERM, "hears_more", True),
    ],
)
def test_one_line_and_the_shells_status(
    number: signal.Signals, work: str, quick: bool, tmp_path: Path
) -> None:
    pipe = tmp_path / "alive"
    os.mkfifo(pipe)
    process = subprocess.Popen(
        [sys.executable, "-c", STOPPABLE, str(pipe), work],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # nohup ignores it for all
    )
    with pipe.open() as alive:
        assert alive.readline() == "begun\n"
        began = time.monotonic()
        process.send_signal(number)
        process.send_signal(number)  # changes nothing
        assert set(alive.read().splitlines()) <= {"begun"}  # till the fork is gone, too
        _, errors = process.communicate()
        took = time.monotonic() - began
    how = "interrupted" if number == signal.SIGINT else "stopped"
    assert (process.returncode, errors) == (128 + number, f"{how}: all is kept\n")
    assert quick or took >= stops.GRACE
    assert took < 5


def test_without_a_signal_all_is_as_before(capsys: pytest.CaptureFixture[str]) -> None:
    handlers = [signal.getsignal(number) for number in stops.SIGNALS]
    with stoppable("nothing"):
        assert signal.getsignal(signal.SIGTERM) != handlers[1]
    with pytest.raises(ValueError, match="a bug"), stoppable("nothing"):
        raise ValueError("a bug")
    with pytest.raises(SystemExit) as end, stoppable("nothing"):
        raise KeyboardInterrupt
    assert end.value.code == 130
    assert capsys.readouterr().err == "interrupted: nothing\n"
    assert [signal.getsignal(number) for number in stops.SIGNALS] == handlers
    assert not issubclass(Stopped, KeyboardInterrupt)  # Lightning would exit


def test_only_a_process_that_was_started_as_a_child_ends_with_its_parent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    watched: list[int] = []
    monkeypatch.setattr(stops, "end_with", watched.append)
    monkeypatch.delenv(PARENT, raising=False)
    end_with_parent()
    assert watched == []
    with monkeypatch.context() as launched:
        launched.setenv("TORCHELASTIC_RUN_ID", "none")
        end_with_parent()
    assert watched.pop() == os.getppid()
    with as_parent():
        assert os.environ[PARENT] == str(os.getpid())
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
        end_with_parent()
        end_with_parent()  # of its children, it is the parent
    assert watched == [os.getpid()]
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert PARENT not in os.environ
    with as_parent():
        with as_parent():  # as another thread's, that ends first
            pass
        assert os.environ[PARENT] == str(os.getpid())
    assert PARENT not in os.environ
