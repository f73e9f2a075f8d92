"""Processes whose output is shown and kept, and which do not outlive the one that started them."""

from __future__ import annotations

import os
import subprocess
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

from tf_lab.support.stops import PARENT, as_parent


class Children:
    """Processes whose output is read here, and which can all be ended at once."""

    def __init__(self) -> None:
        self._running: set[subprocess.Popen[str]] = set()
        self._ended = False
        self._lock = threading.Lock()

    def run(
        self, command: Sequence[str], log: Path, variables: Mapping[str, str], prefix: str = ""
    ) -> int:
        """Run a process; its output goes to the log and, with a prefix, to the screen.

        Args:
            command: of it.
            log: a file.
            variables: its environment, in which this process is its `PARENT`.
            prefix: of its lines on the screen.

        Returns:
            Its exit status; minus the number of the signal that killed it.
        """
        environment = {**variables, "PYTHONUNBUFFERED": "1", PARENT: str(os.getpid())}
        with log.open("w") as file, self._started(command, environment) as process:
            try:
                assert process.stdout is not None
                for line in process.stdout:
                    print(line, end="", file=file, flush=True)
                    if not self._ended:
                        print(prefix + line, end="", flush=True)
            except BaseException:  # interrupted: the process must not go on alone
                process.terminate()
                raise
            finally:
                with self._lock:
                    self._running.discard(process)
        return process.returncode

    def _started(
        self, command: Sequence[str], environment: dict[str, str]
    ) -> subprocess.Popen[str]:
        with self._lock:
            if self._ended:
                raise KeyboardInterrupt
            with as_parent():
                process = subprocess.Popen(
                    command,
                    env=environment,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    text=True,
                    errors="replace",
                )
            self._running.add(process)
            return process

    def terminate(self) -> None:
        """End all, and start none any more."""
        with self._lock:
            self._ended = True
            for process in self._running:
                process.terminate()
