"""One look for all progress bars."""

from __future__ import annotations

import time
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

EVERY = 60.0  # seconds between the lines in a log


class _Lines(Progress):
    """A progress bar for logs: a line now and then instead of one that is drawn again."""

    def __init__(self, *columns: Any) -> None:
        super().__init__(*columns, console=Console(width=120))
        self.last = time.monotonic()

    def update(self, task_id: TaskID, *args: Any, **changes: Any) -> None:
        """Print a line if the last one is long ago."""
        super().update(task_id, *args, **changes)
        if time.monotonic() - self.last >= EVERY:
            self.last = time.monotonic()
            self.console.print(self.get_renderable())


def progress_bar() -> Progress:
    """A progress bar with counts, elapsed and remaining time; lines where there is no terminal."""
    bar = Progress if Console().is_terminal else _Lines
    return bar(
        TextColumn("{task.description}"),
        BarColumn(bar_width=12),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
