"""How processes end: at a signal, with one line and the shell's exit status; and with their parent.

Tidying up is given `GRACE` seconds. Nothing depends on it: what is half written is never read,
locks are freed by the kernel, and children end with their parent however that ends.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn

PARENT = "TF_LAB_PARENT"  # the process that a child is to end with
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
GRACE = 2.0  # seconds
IMPORTS = "<frozen importlib"  # of the names of the interpreter's files
TORCHRUN = "TORCHELASTIC_RUN_ID"  # in the environment of what torchrun starts
PR_SET_PDEATHSIG = 1  # of Linux: the signal that a process gets when its parent ends

_parents, _parents_lock = 0, threading.Lock()  # blocks of `as_parent`, also in several threads
_process = 0  # the process whose stop is a line and a status; its forks end with it


class Stopped(BaseException):
    """A signal ends this process. No `KeyboardInterrupt`: at one, Lightning exits by itself."""


@contextlib.contextmanager
def stoppable(keeps: str) -> Iterator[None]:
    """In the main thread: end the process at SIGINT, SIGTERM and SIGHUP with status 128 + number.

    The first of them is raised as `Stopped`, further ones change nothing. Who has not ended
    `GRACE` seconds later, because the exception got lost or because something waits, is ended.

    SIGINT is heard also where a shell started the process in the background; SIGHUP is not, where
    it is ignored (nohup).

    Args:
        keeps: what a stop leaves behind, for the line that it prints.
    """
    global _process
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    stop = _Stop(keeps)
    numbers = [n for n in SIGNALS if n == signal.SIGINT or signal.getsignal(n) != signal.SIG_IGN]
    before = {number: signal.signal(number, stop.hear) for number in numbers}
    hook_before, sys.unraisablehook = sys.unraisablehook, stop.lost
    fd_before, _process = signal.set_wakeup_fd(stop.pipe, warn_on_full_buffer=False), os.getpid()
    interrupted = False
    try:
        yield
    except KeyboardInterrupt:  # raised without a signal
        interrupted = True
    except BaseException:
        if not stop.number:
            raise
    finally:
        if not stop.number:
            _process = 0
            signal.set_wakeup_fd(fd_before)
            sys.unraisablehook = hook_before
            for number, handler in before.items():
                signal.signal(number, handler)
            os.close(stop.pipe)
    if stop.number:  # also where `Stopped` became something else, or was lost
        stop.end(stop.number)
    if interrupted:
        stop.tell(signal.SIGINT)
        sys.exit(128 + signal.SIGINT)


class _Stop:
    """Hears the signal: as an exception in the main thread, and by a thread that ends the rest."""

    def __init__(self, keeps: str) -> None:
        self.keeps, self.number, self._told = keeps, 0, False
        end, self.pipe = os.pipe()  # the interpreter writes signals to it, whatever it is at
        os.set_blocking(self.pipe, False)
        threading.Thread(target=self._watch, args=(end,), daemon=True).start()

    def hear(self, number: int, frame: FrameType | None) -> None:
        if not self.number:
            self.number = number
            if _is_fragile(frame):
                self.end(number)
            raise Stopped(signal.Signals(number).name)

    def lost(self, what: sys.UnraisableHookArgs) -> None:
        """End where the exception would get lost with a traceback: in a finaliser."""
        if issubclass(what.exc_type, Stopped):
            self.end(self.number)
        sys.__unraisablehook__(what)

    def end(self, number: int) -> NoReturn:
        """End without what the interpreter does at its end, at which the thread may crash it."""
        self.tell(number)
        atexit._run_exitfuncs()  # of loggers, of multiprocessing
        os._exit(128 + number)

    def tell(self, number: int) -> None:
        """Print the line, once; of a distributed training, its first process does."""
        if not self._told and os.environ.get("LOCAL_RANK", "0") == "0":
            self._told = True
            how = "interrupted" if number == signal.SIGINT else "stopped"
            echo = "\n" if sys.stderr.isatty() else ""  # after ^C
            with contextlib.suppress(OSError, ValueError):
                sys.stdout.flush()
                print(f"{echo}{how}: {self.keeps}", file=sys.stderr, flush=True)

    def _watch(self, end: int) -> None:
        byte = b"-"
        while byte and byte[0] not in SIGNALS:
            byte = os.read(end, 1)
        if byte:  # the pipe stays open: ends of children are written to it, too
            time.sleep(GRACE)
            self.tell(byte[0])
            os._exit(128 + byte[0])
        os.close(end)


def _is_fragile(frame: FrameType | None) -> bool:
    """Whether an exception here may crash the interpreter.

    In an import a library would be left half set up; and threads that are waited for, such as
    those of scipy's trees, would lose what they work on.
    """
    while frame is not None:
        code = frame.f_code
        if code is threading.Thread.join.__code__ or code.co_filename.startswith(IMPORTS):
            return True
        frame = frame.f_back
    return False


def _forked() -> None:
    """A forked child, such as a loader's worker, ends with its parent, and silently."""
    global _process
    if _process:
        signal.set_wakeup_fd(-1)
        for number in SIGNALS:
            signal.signal(number, lambda *_: os._exit(0))
        parent, _process = _process, os.getpid()
        end_with(parent)  # which may be gone by now


os.register_at_fork(after_in_child=_forked)


def end_with(parent: int) -> None:
    """End this process when ``parent`` is not its parent any more, even if that was killed.

    On Linux the kernel does it at once, whatever this process is at (it means the thread that
    started it); elsewhere a thread does, as soon as the interpreter lets it.
    """
    import ctypes

    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL))
        if os.getppid() != parent:  # it was quicker
            os._exit(1)
        return

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def end_with_parent() -> None:
    """End this process when the one ends that started it, by `as_parent` or as torchrun does."""
    parent = os.environ.pop(PARENT, None)
    if parent is None and TORCHRUN in os.environ:  # which would leave it behind, if killed
        parent = str(os.getppid())
    if parent is not None:
        end_with(int(parent))


@contextlib.contextmanager
def as_parent(deaf: bool = True) -> Iterator[None]:
    """Processes of this package that are started meanwhile end with this one.

    Args:
        deaf: they don't hear SIGINT, which a terminal sends to all: this process ends them.
    """
    global _parents
    with _parents_lock:
        _parents += 1
        os.environ[PARENT] = str(os.getpid())
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT} if deaf else ())
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        with _parents_lock:
            _parents -= 1
            if not _parents:
                os.environ.pop(PARENT, None)
