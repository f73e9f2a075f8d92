"""Whether something fits this machine's memory, told before it is begun."""

from __future__ import annotations

import os

from tf_lab.errors import TFLabError


def check_memory(what: str, nbytes: float, cure: str) -> None:
    """That something takes no more memory than there is.

    Args:
        what: takes it, for the message.
        nbytes: an estimate.
        cure: what to do.

    Raises:
        TFLabError: it takes more.
    """
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if nbytes > there:
        raise TFLabError(
            f"{what} takes about {nbytes / 2**30:,.0f} GiB, this machine has {there / 2**30:,.0f}; "
            f"{cure}"
        )
