"""A command: what it is called, what it does, and what stays when it is stopped."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Sequence

from tf_lab.support.stops import stoppable

# Threads of OpenMP (torch's is GNU's) wait for each other by turning in circles. After so many they
# sleep, unless told otherwise before torch is loaded: on cores that have other work, such as the
# browser that shows the page, waiting longer takes from what is waited for.
WAITING = ("GOMP_SPINCOUNT", "1000")
CACHES = ("TF_LAB_CACHE", "XDG_CACHE_HOME")
TRAINING_DATA = tuple(  # of embedded sets, which a command that shows a test scene does not read
    f"data.{name}"
    for name in ("size", "rooms", "val_size", "frames", "furniture", "textures", "urls", "shuffle")
)
AGAIN = "what it wrote is whole, the same command starts again"


def command(
    name: str,
    about: str | None,
    target: str,
    *,
    unused: Sequence[str] = (),
    keeps: str = AGAIN,
    jobs: str = "",
) -> Callable[[], None]:
    """A command: Hydra composes its config, ``target`` gets it typed; every error is one line.

    The exit status of an error is 2; a traceback is printed as well if the environment has
    ``TF_LAB_DEBUG=1``. A signal ends it as `stoppable` says. What does the work is imported only
    when there is work to do.

    Args:
        name: of the command, of its config and its schema.
        about: what it does and how it is called.
        target: the function, as ``package.module:name``; its argument is the typed config.
        unused: settings (or groups of them) that the command does not read.
        keeps: what there is when it was stopped, and whether the same command goes on from it.
        jobs: where the `SweepJobs` are of a command whose sweeps run each job as a process.
    """

    def main() -> None:
        print_anything()
        for variable in CACHES:
            if os.environ.get(variable) == "":  # which means none
                del os.environ[variable]
        if "OMP_WAIT_POLICY" not in os.environ:
            os.environ.setdefault(*WAITING)
        with stoppable(keeps):
            from tf_lab.cli.run import run_command  # takes a second, in which signals are heard

            run_command(name, about or "", target, unused, jobs)

    return main


def print_anything() -> None:
    """Print a question mark for what standard output has no letter for, instead of ending there."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
