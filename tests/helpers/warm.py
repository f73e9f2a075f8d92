"""Commands as forks of this process, which has imported what they import.

That is most of the time of a short one. All else is as in a process that a shell starts: a
session, random states and signal handlers of its own.
"""

from __future__ import annotations

import importlib
import os
import random
import runpy
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

MODULES = "TF_LAB_TESTS_MODULES"  # in the environment: where a command lists what it imported


class Warm:
    """A running command, with what of `subprocess.Popen` its tests need."""

    def __init__(
        self, command: str, words: Sequence[str], cwd: Path, out: Path, err: Path, **variables: str
    ) -> None:
        self._status: int | None = None
        self.pid = os.fork()
        if self.pid == 0:
            status = 1
            try:
                status = _run(command, words, cwd, (out, err), variables)
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(status)

    def wait(self, timeout: float) -> int:
        """The exit status, negative if a signal ended it.

        Raises:
            subprocess.TimeoutExpired: it has not ended.
        """
        end = time.monotonic() + timeout
        while self._status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._status = os.waitstatus_to_exitcode(status)
            elif time.monotonic() > end:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            else:
                time.sleep(0.01)
        return self._status


def warm_up(command: str, words: Sequence[str], cwd: Path) -> None:
    """Run a command once, and import here what it imported."""
    listed = cwd / "modules.txt"
    done = Warm(command, words, cwd, cwd / "out.txt", cwd / "err.txt", **{MODULES: str(listed)})
    assert done.wait(3600) == 0, (cwd / "err.txt").read_text()
    for name in listed.read_text().split():
        if name not in sys.modules:
            try:
                importlib.import_module(name)
            except Exception:  # made by another on import, or to be imported by that alone
                continue


def _run(
    command: str,
    words: Sequence[str],
    cwd: Path,
    streams: Sequence[Path],
    variables: dict[str, str],
) -> int:
    """In the fork: what ``python -m tf_lab.<command>`` does; its status."""
    os.setsid()
    os.chdir(cwd)
    for number in (signal.SIGALRM, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    for number, path in enumerate(streams, start=1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
    os.environ.update(variables)
    random.seed()
    np.random.seed(None)  # noqa: NPY002
    torch.seed()
    sys.argv = [f"tf_lab/{command}.py", *words]
    status = 0
    try:
        runpy.run_module(f"tf_lab.{command}", run_name="__main__", alter_sys=True)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    if MODULES in variables:
        Path(variables[MODULES]).write_text("\n".join(sys.modules))
    return status
