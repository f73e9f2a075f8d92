"""Building scene directories in parallel: each is whole or absent, and none stops the others."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path

from tf_lab.errors import TFLabError
from tf_lab.support.files import atomic_directory, remove_abandoned
from tf_lab.support.locks import directory_lock
from tf_lab.support.tasks import run_tasks

Builder = Callable[[Path], None]


def build_scenes(builders: Mapping[Path, Builder], title: str, workers: int | None) -> None:
    """Build the scenes that do not exist yet, one process a scene.

    Args:
        builders: by a scene's directory, what writes it into a temporary one; existing directories
            are kept as they are.
        title: for the progress bar.
        workers: processes; None: one a core.

    Raises:
        TFLabError: some scenes failed (after all others were built); names them.
    """
    missing = _missing(builders)
    if not missing:
        return
    with contextlib.ExitStack() as locks:
        for folder in sorted({directory.parent for directory in missing}):
            locks.enter_context(directory_lock(folder, "preparing"))
            remove_abandoned(folder)
        tasks = {d.name: partial(_build, d, builders[d]) for d in _missing(builders)}
        failed = run_tasks(tasks, title, workers) if tasks else {}
    if failed:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in failed.items())
        raise TFLabError(f"{len(failed)} of {len(builders)} scenes failed: {reasons}")


def _missing(directories: Iterable[Path]) -> list[Path]:
    return [directory for directory in directories if not directory.is_dir()]


def _build(directory: Path, builder: Builder) -> None:
    if directory.is_dir():  # another process was faster
        return
    with atomic_directory(directory) as temporary:
        builder(temporary)
