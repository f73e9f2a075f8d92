"""A directory's lock says who holds it, and ends with its holder."""

import os
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from queue import Queue

import pytest

from tf_lab.errors import TFLabError
from tf_lab.support import locks
from tf_lab.support.locks import directory_lock, lock_holder

HOLD = """
import sys, time
from pathlib import Path
from tf_lab.support.locks import directory_lock
with directory_lock(Path(sys.argv[1]), "training"):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_lock_says_who_holds_it_and_outlives_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = tmp_path / "training"
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(directory)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    who = f"process {process.pid} on {socket.gethostname()}"
    assert lock_holder(directory) == who

    told: Queue[str] = Queue()
    monkeypatch.setattr(locks, "print", lambda line, **_: told.put(line), raising=False)
    entered = threading.Event()

    def wait() -> None:
        with directory_lock(directory, "training"):
            entered.set()

    waiting = threading.Thread(target=wait)
    waiting.start()
    assert told.get(timeout=60) == f"waiting for {who}: training {directory}"
    assert not entered.is_set()
    process.kill()
    waiting.join(60)
    assert entered.is_set()
    process.wait()
    assert lock_holder(directory) is None


def test_what_was_made_for_nothing_is_removed(tmp_path: Path) -> None:
    there = tmp_path / "there"
    there.mkdir()
    for directory in (there, there / "new" / "newer"):
        with directory_lock(directory, "training") as made:
            assert made == (directory != there)
    assert [path.name for path in there.iterdir()] == [".lock"]
    (there / ".lock").unlink()
    with directory_lock(there / "new" / "newer", "training"):
        (there / "new" / "newer" / "result").touch()
    with directory_lock(there / "new" / "other", "training"):
        pass
    assert {path.name for path in there.rglob("*")} == {"new", "newer", ".lock", "result"}


def test_who_waits_for_what_is_removed_makes_it_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else two would hold a lock of one name: one of a file that is gone, one of the next."""
    directory, waits, entered = tmp_path / "training", threading.Event(), threading.Event()
    done = threading.Event()
    monkeypatch.setattr(locks, "print", lambda *_, **__: waits.set(), raising=False)

    def wait() -> None:
        with directory_lock(directory, "training"):
            entered.set()
            done.wait(60)

    waiting = threading.Thread(target=wait)
    with directory_lock(directory, "training"):
        waiting.start()
        assert waits.wait(60)
        assert not entered.is_set()
    assert entered.wait(60)
    assert lock_holder(directory) == f"process {os.getpid()} on {socket.gethostname()}"
    done.set()
    waiting.join(60)
    assert not directory.exists()


def test_asking_leaves_nothing_behind(tmp_path: Path) -> None:
    assert lock_holder(tmp_path) is None
    assert not list(tmp_path.iterdir())


def test_what_another_host_left_locks_nothing(tmp_path: Path) -> None:
    """As after a machine that went down: the note stays, the kernel's lock does not."""
    (tmp_path / ".lock").touch()
    (tmp_path / ".holder").write_text("process 7 on elsewhere")
    assert lock_holder(tmp_path) is None
    with directory_lock(tmp_path, "training"):
        assert lock_holder(tmp_path) == f"process {os.getpid()} on {socket.gethostname()}"


@pytest.fixture
def read_only() -> Iterator[Path]:
    """A folder that this process cannot write to: root becomes another user for that."""
    with tempfile.TemporaryDirectory() as name:  # not pytest's, which only its owner may enter
        folder, owner = Path(name), os.geteuid()
        folder.chmod(0o555)
        os.seteuid(owner or 12345)
        try:
            yield folder
        finally:
            os.seteuid(owner)
            folder.chmod(0o755)


@pytest.mark.parametrize("name", [".", "runs/new"])
def test_a_folder_that_cannot_be_written_to_is_told(read_only: Path, name: str) -> None:
    place = read_only / name
    with (
        pytest.raises(TFLabError, match=rf"^{place}: cannot be written \(Permission denied\)"),
        directory_lock(place, "training"),
    ):
        pass
