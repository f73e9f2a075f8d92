"""Where the time goes: seconds a stage, without those of the stages inside it."""

from __future__ import annotations

import functools
import time
from collections import defaultdict
from typing import Any

import torch


class Stopwatch:
    """Adds up the time that watched methods take.

    Args:
        device: synchronised before the clock is read, so that a stage pays for its own kernels.
    """

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self.seconds: dict[str, float] = defaultdict(float)
        self._inside: list[float] = []

    def now(self) -> float:
        """Seconds, all work done."""
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return time.perf_counter()

    def watch(self, owner: Any, method: str, stage: str) -> None:
        """Count the calls of ``owner.method`` under ``stage``."""
        original = getattr(owner, method)

        @functools.wraps(original)
        def timed(*args: Any, **kwargs: Any) -> Any:
            start = self.now()
            self._inside.append(0.0)
            try:
                return original(*args, **kwargs)
            finally:
                whole = self.now() - start
                self.seconds[stage] += whole - self._inside.pop()
                if self._inside:
                    self._inside[-1] += whole

        setattr(owner, method, timed)

    def take(self) -> dict[str, float]:
        """Seconds by stage since the last call."""
        found = dict(self.seconds)
        self.seconds.clear()
        return found
