"""Building scene directories in parallel: each is whole or absent, and none stops the others."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tf_lab.errors import TFLabError
from tf_lab.support.files import atomic_directory, remove_abandoned
from tf_lab.support.locks import directory_lock
from tf_lab.support.tasks import run_tasks


@dataclass(frozen=True)
class SceneJob:
    """A scene to build: its final directory, and what writes it into a temporary one."""

    directory: Path
    build: Callable[[Path], None]


def build_scenes(jobs: Sequence[SceneJob], title: str, workers: int | None) -> None:
    """Build the scenes that do not exist yet, one process a scene.

    Args:
        jobs: the scenes; existing directories are kept as they are.
        title: for the progress bar.
        workers: processes; None: one a core.

    Raises:
        TFLabError: some scenes failed (after all others were built); names them.
    """
    missing = _missing(jobs)
    if not missing:
        return
    with contextlib.ExitStack() as locks:
        for folder in sorted({job.directory.parent for job in missing}):
            locks.enter_context(directory_lock(folder, "preparing"))
            remove_abandoned(folder)
        tasks = {job.directory.name: partial(_build, job) for job in _missing(jobs)}
        failed = run_tasks(tasks, title, workers) if tasks else {}
    if failed:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in failed.items())
        raise TFLabError(f"{len(failed)} of {len(jobs)} scenes failed: {reasons}")


def _missing(jobs: Sequence[SceneJob]) -> list[SceneJob]:
    return [job for job in jobs if not job.directory.is_dir()]


def _build(job: SceneJob) -> None:
    if job.directory.is_dir():  # another process was faster
        return
    with atomic_directory(job.directory) as temporary:
        job.build(temporary)
