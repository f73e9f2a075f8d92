"""One look for all progress bars."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

T = TypeVar("T")

FIRST, EVERY = 2.0, 60.0  # seconds to the first line in a log, and between the others
RECENT = 30.0  # seconds of which the pace is taken


class _Lines(Progress):
    """A progress bar for logs: a line soon and then now and then, whether or not anything is done.

    What ends before the first of them has its last line only.
    """

    def __init__(self, *columns: Any) -> None:
        super().__init__(*columns, console=Console(width=120), auto_refresh=False)
        self._ended = threading.Event()

    def start(self) -> None:
        """Begin to print."""
        super().start()
        threading.Thread(target=self._print, daemon=True).start()

    def stop(self) -> None:
        """Print the last line."""
        self._ended.set()
        super().stop()

    def _print(self) -> None:
        wait = FIRST
        while not self._ended.wait(wait):
            self.console.print(self.get_renderable())
            wait = EVERY


class _TimeLeft(TimeRemainingColumn):
    """The task's own estimate (``left``, seconds), where it has one."""

    def render(self, task: Task) -> Text:
        """As hours, minutes and seconds."""
        left = task.fields.get("left")
        if left is None or task.finished:
            return super().render(task)
        minutes, seconds = divmod(round(left), 60)
        text = f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"
        return Text(text, style="progress.remaining")


@dataclass(frozen=True)
class Once:
    """Work that is done when an item is asked for the first time, and not again.

    Attributes:
        asked: items asked for, all in all.
        done: of them those that had to be worked on.
        seconds: which that took.
    """

    asked: int = 0
    done: int = 0
    seconds: float = 0.0


class Pace:
    """How long steps will take, of which the first are slower: they do what is done but once.

    The time of the recent steps is taken without that work. What there is still of it follows from
    how many of the items asked for recently were new: of N items at random, ``done`` of them known,
    1 - done / N are.
    """

    def __init__(self) -> None:
        self._recent: deque[tuple[float, int, Once]] = deque()

    def restart(self) -> None:
        """Forget the steps so far: something else has taken time since."""
        self._recent.clear()

    def left(self, now: float, step: int, steps: int, once: Once) -> float | None:
        """Seconds left after a step; None: it cannot be told yet.

        Args:
            now: seconds, of any clock.
            step: done, in all.
            steps: to do, in all.
            once: the work done once, so far.
        """
        self._recent.append((now, step, once))
        while len(self._recent) > 2 and self._recent[1][0] < now - RECENT:
            self._recent.popleft()
        before, first, past = self._recent[0]
        if step == first:
            return None
        done, asked = once.done - past.done, once.asked - past.asked
        other = (now - before - (once.seconds - past.seconds)) / (step - first)
        to_ask = asked / (step - first) * (steps - step)
        if done == 0:
            return (steps - step) * other
        new = done / (asked + 1)  # as if one more had been known: none of a few says little
        items = once.done / (1 - new)
        more = (items - once.done) * -math.expm1(-to_ask / items)
        return (steps - step) * other + more * once.seconds / once.done


def tracked(items: Sequence[T], description: str) -> Iterator[T]:
    """Items with a progress bar on standard error, if that is a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield from items
        return
    with Progress(*_columns(), console=console, transient=True) as bar:
        yield from bar.track(items, len(items), description=description)


def progress_bar() -> Progress:
    """A progress bar with counts, elapsed and remaining time; lines where there is no terminal."""
    bar = Progress if Console().is_terminal else _Lines
    return bar(*_columns())


def _columns() -> list[ProgressColumn]:
    return [
        TextColumn("{task.description}"),
        BarColumn(bar_width=12),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        _TimeLeft(),
        TextColumn("left"),
    ]
