"""Processes that must not outlive the one that started them."""

from __future__ import annotations

import os
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

PARENT = "TF_LAB_PARENT"  # the process that waits for this one


def end_with(parent: int) -> None:
    """End this process when ``parent`` is not its parent any more, even if that was killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def end_with_parent() -> None:
    """End this process as soon as the one that waits for it is gone, even if that was killed."""
    parent = os.environ.pop(PARENT, None)  # helpers of a distributed training have another
    if parent is not None:
        end_with(int(parent))


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
                    print(prefix + line, end="", flush=True)
            except BaseException:  # interrupted: the process must not go on alone
                process.terminate()
                raise
            finally:
                self._running.discard(process)
        return process.returncode

    def _started(
        self, command: Sequence[str], environment: dict[str, str]
    ) -> subprocess.Popen[str]:
        with self._lock:
            if self._ended:
                raise KeyboardInterrupt
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
