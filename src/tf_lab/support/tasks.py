"""Named tasks in processes: one that fails does not stop the others, and memory is shared out."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial

import torch

from tf_lab.errors import TFLabError
from tf_lab.support.progress import progress_bar
from tf_lab.support.stops import Stopped, as_parent

NO_MEMORY = "its process ran out of memory; use fewer data.workers, or more memory"


def run_tasks(
    tasks: Mapping[str, Callable[[], None]], title: str, workers: int | None = None
) -> dict[str, str]:
    """Run named tasks in processes; one that fails does not stop the others.

    Where memory runs out, a GPU's or the system's, whose killer ends a process, what is unfinished
    is tried again in half as many, until it is known who finds none by itself.

    Args:
        tasks: picklable.
        title: for the progress bar.
        workers: processes; None: one a core.

    Returns:
        Why which task failed, by its name.
    """
    workers = min(workers or os.cpu_count() or 1, len(tasks))
    failed: dict[str, str] = {}
    unfinished = dict(tasks)
    with progress_bar() as bar:
        row = bar.add_task(title, total=len(tasks))
        while unfinished:
            if not _run_some(unfinished, failed, workers, partial(bar.advance, row)):
                continue
            if workers == 1:  # in turn, so that it was the first
                name = next(iter(unfinished))
                del unfinished[name]
                failed[name] = NO_MEMORY
                bar.advance(row)
            workers = max(1, min(workers // 2, len(unfinished)))
    return failed


def _run_some(
    unfinished: dict[str, Callable[[], None]],
    failed: dict[str, str],
    workers: int,
    advance: Callable[[], None],
) -> bool:
    """Run tasks until all are finished or a process dies; whether one did."""
    context = multiprocessing.get_context("spawn")
    died = False
    with ProcessPoolExecutor(
        workers, mp_context=context, initializer=torch.set_num_threads, initargs=(1,)
    ) as pool:
        try:
            with as_parent():
                futures = {pool.submit(task): name for name, task in unfinished.items()}
            for future in as_completed(futures):
                try:
                    future.result()
                except BrokenProcessPool:
                    died = True
                    continue
                except TFLabError as error:
                    failed[futures[future]] = str(error)
                except (MemoryError, torch.OutOfMemoryError, torch.AcceleratorError) as error:
                    if workers > 1:  # fewer may all find what they need
                        died = True
                        continue
                    failed[futures[future]] = f"{NO_MEMORY} ({error})".removesuffix(" ()")
                del unfinished[futures[future]]
                advance()
        except (Stopped, KeyboardInterrupt):  # else the pool would do all that is asked of it
            for process in multiprocessing.active_children():
                process.kill()
            raise
    return died
