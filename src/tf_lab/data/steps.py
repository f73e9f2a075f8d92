"""The steps of an endless stream, shared out among a loader's processes."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from torch.utils.data import get_worker_info


def own_steps(first: int) -> Iterator[int]:
    """This process's steps from ``first`` on: a loader asks its processes in turn."""
    worker = get_worker_info()
    offset, stride = (worker.id, worker.num_workers) if worker else (0, 1)
    return itertools.count(first + offset, stride)
