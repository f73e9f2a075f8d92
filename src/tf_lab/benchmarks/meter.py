"""Where the time (or the work) goes: what each stage takes, without the stages inside it."""

from __future__ import annotations

import functools
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import torch


def clock(device: torch.device) -> Callable[[], float]:
    """Tells the seconds, all of a GPU's work done, so that a stage pays for its own.

    Of a process with one thread and without a GPU it is the processor's time, so that what others
    do on the machine does not count.
    """
    if device.type != "cuda":
        return time.process_time if torch.get_num_threads() == 1 else time.perf_counter

    def now() -> float:
        torch.cuda.synchronize(device)
        return time.perf_counter()

    return now


class Meter:
    """Adds up what watched methods use.

    Args:
        read: a quantity that only grows: seconds (`clock`), FLOPs done, voxels measured.
    """

    def __init__(self, read: Callable[[], float]) -> None:
        self.read = read
        self.used: dict[str, float] = defaultdict(float)
        self._inside: list[float] = []

    def watch(self, owner: Any, method: str, stage: str) -> None:
        """Count the calls of ``owner.method`` under ``stage``."""
        original = getattr(owner, method)

        @functools.wraps(original)
        def metered(*args: Any, **kwargs: Any) -> Any:
            start = self.read()
            self._inside.append(0.0)
            try:
                return original(*args, **kwargs)
            finally:
                whole = self.read() - start
                self.used[stage] += whole - self._inside.pop()
                if self._inside:
                    self._inside[-1] += whole

        setattr(owner, method, metered)

    def take(self) -> dict[str, float]:
        """What was used by stage since the last call."""
        found = dict(self.used)
        self.used.clear()
        return found
