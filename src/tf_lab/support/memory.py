"""Too little memory, told in a line: before something is begun, or when there is none left."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from tf_lab.errors import TFLabError

# of torch's errors, which are plain ones on a CPU
NONE_LEFT = ("out of memory", "can't allocate memory", "not enough memory")


def total_memory() -> int:
    """Bytes of memory that this machine has."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def check_memory(what: str, nbytes: float, cure: str) -> None:
    """That something takes no more memory than there is.

    Args:
        what: takes it, for the message.
        nbytes: an estimate.
        cure: what to do.

    Raises:
        TFLabError: it takes more.
    """
    there = total_memory()
    if nbytes > there:
        raise TFLabError(
            f"{what} takes about {nbytes / 2**30:,.0f} GiB, this machine has {there / 2**30:,.0f}; "
            f"{cure}"
        )


@contextmanager
def telling_no_memory(what: str, cure: str) -> Iterator[None]:
    """Say in one line that memory has run out, a GPU's or the system's, and what to do.

    Args:
        what: is being done, for the message.
        cure: takes less.

    Raises:
        TFLabError: it has. All else is raised as it is.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        told = " ".join(str(error).split())
        if not isinstance(error, MemoryError) and not any(w in told.lower() for w in NONE_LEFT):
            raise
        reason = ". ".join(told.split(". ")[:2]).rstrip(".")  # what was asked for; then advice
        because = f" ({reason})" if reason else ""
        raise TFLabError(f"{what}: too little memory{because}; {cure}") from error
