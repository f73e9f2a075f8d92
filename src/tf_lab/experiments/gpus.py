"""Jobs side by side on a machine of several GPUs: each has one of its own, while there are any."""

from __future__ import annotations

import contextlib
import itertools
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from filelock import FileLock, Timeout

VISIBLE = "CUDA_VISIBLE_DEVICES"


@contextlib.contextmanager
def one_gpu() -> Iterator[dict[str, str]]:
    """Environment variables by which a process sees one GPU only, of those no other job holds.

    Empty where there are not several.
    """
    gpus = visible()
    if len(gpus) < 2:
        yield {}
        return
    places = Path(tempfile.gettempdir()) / f"tf_lab-gpus-{os.getuid()}"
    with reserved(gpus, places) as gpu:
        yield {VISIBLE: gpu}


def visible() -> list[str]:
    """The GPUs that torch sees here, as CUDA names them."""
    import torch  # slow; a sweep that reuses all it asks for needs none

    count = torch.cuda.device_count()
    named = os.environ.get(VISIBLE)
    return (named.split(",") if named else [str(i) for i in range(count)])[:count]


@contextlib.contextmanager
def reserved(gpus: Sequence[str], places: Path) -> Iterator[str]:
    """Hold a place on a GPU: the first place of each goes before the second of any.

    The kernel frees it when its holder dies.

    Args:
        gpus: the names to choose from.
        places: folder of the locks, one for all jobs of the machine.
    """
    places.mkdir(exist_ok=True)
    names = ((gpu, f"{gpu}-{i}".replace("/", "_")) for i in itertools.count() for gpu in gpus)
    locks = ((gpu, FileLock(places / name)) for gpu, name in names)
    gpu, lock = next((gpu, lock) for gpu, lock in locks if _acquired(lock))
    try:
        yield gpu
    finally:
        lock.release()


def _acquired(lock: FileLock) -> bool:
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return False
    return True
