"""One process at a time in a directory."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path

from filelock import FileLock, Timeout

from tf_lab.errors import TFLabError

LOCK, NOTE = ".lock", ".holder"
TRIES = 100  # to make a directory that others remove again


@contextlib.contextmanager
def directory_lock(directory: Path, activity: str) -> Iterator[bool]:
    """Hold a directory's lock, which the kernel frees when its holder dies.

    Says who holds it when it must wait: "waiting for process 7 on HOST: training DIRECTORY".

    Args:
        directory: made if it is missing, and removed again if nothing was put into it.
        activity: of whoever holds it, such as "training".

    Yields:
        Whether it was made.

    Raises:
        TFLabError: it cannot be made or written to.
    """
    lock = FileLock(directory / LOCK)
    try:
        made = _acquire(lock, directory, activity)
    except OSError as error:
        raise TFLabError(
            f"{directory}: cannot be written ({error.strerror}); make it writable, or choose "
            "another place by the setting that names it"
        ) from error
    note = directory / NOTE
    try:
        with contextlib.suppress(OSError):  # a full disk
            note.write_text(f"process {os.getpid()} on {socket.gethostname()}")
        yield bool(made)
    finally:
        note.unlink(missing_ok=True)
        if made:
            _remove_empty(made)
        lock.release()


def _acquire(lock: FileLock, directory: Path, activity: str) -> list[Path]:
    """Get the lock: the folders that were made for it, the directory first."""
    tries = TRIES
    while True:
        made = list(takewhile(lambda path: not path.exists(), (directory, *directory.parents)))
        try:
            directory.mkdir(parents=True, exist_ok=True)
            try:
                lock.acquire(timeout=0)
            except Timeout:
                print(f"waiting for {lock_holder(directory)}: {activity} {directory}", flush=True)
                lock.acquire()
                if not made and _is_empty(directory):  # whoever made it has given up, and left it
                    made = [directory]
            return made
        except (FileNotFoundError, FileExistsError):  # whoever made it has removed it meanwhile
            tries -= 1
            if not tries:
                raise


def _remove_empty(made: list[Path]) -> None:
    """Remove folders that hold nothing but the lock; who waits for that makes them anew."""
    with contextlib.suppress(OSError):  # somebody else has put something into them
        if _is_empty(made[0]):
            (made[0] / LOCK).unlink()
            for folder in made:
                folder.rmdir()


def _is_empty(directory: Path) -> bool:
    """Whether it holds nothing but the lock."""
    return [path.name for path in directory.iterdir()] == [LOCK]


def lock_holder(directory: Path) -> str | None:
    """Who holds a directory's lock; None: nobody."""
    if not (directory / LOCK).exists():  # asking leaves nothing behind
        return None
    lock = FileLock(directory / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        note = directory / NOTE
        return (note.read_text() if note.exists() else "") or "another process"
    except OSError:  # no place for a lock: nobody can hold it
        return None
    lock.release()
    return None
