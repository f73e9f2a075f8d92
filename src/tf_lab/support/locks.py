"""One process at a time in a directory."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from tf_lab.errors import TFLabError


@contextlib.contextmanager
def directory_lock(directory: Path, activity: str) -> Iterator[None]:
    """Hold a directory's lock, which the kernel frees when its holder dies.

    Says who holds it when it must wait: "waiting for process 7 on HOST: training DIRECTORY".

    Args:
        directory: made if it is missing.
        activity: of whoever holds it, such as "training".

    Raises:
        TFLabError: it cannot be made or written to.
    """
    lock = FileLock(directory / ".lock")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        print(f"waiting for {lock_holder(directory)}: {activity} {directory}", flush=True)
        lock.acquire()
    except OSError as error:
        raise TFLabError(
            f"{directory}: cannot be written ({error.strerror}); make it writable, or choose "
            "another place by the setting that names it"
        ) from error
    note = directory / ".holder"
    try:
        with contextlib.suppress(OSError):  # a full disk
            note.write_text(f"process {os.getpid()} on {socket.gethostname()}")
        yield
    finally:
        note.unlink(missing_ok=True)
        lock.release()


def lock_holder(directory: Path) -> str | None:
    """Who holds a directory's lock; None: nobody."""
    lock = FileLock(directory / ".lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        note = directory / ".holder"
        return (note.read_text() if note.exists() else "") or "another process"
    except OSError:  # no place for a lock: nobody can hold it
        return None
    lock.release()
    return None
