"""The figures of docs/reliability.md: commands disturbed so many times, and what that did.

    PYTHONPATH=$PWD/src:$PWD/tests python tests/reliability/campaign.py KILL --tries 25 [CASE ...]

KILL, TERM or INT; TERM-group and INT-group send it to all processes; FULL runs out of space.
Several, as in KILL,TERM --tries 25,10.
"""

import argparse
import signal
import sys
import tempfile
import time
from itertools import cycle
from pathlib import Path

from helpers.faults import Counts, full_disk, prepare_inputs, stopped, watch

LEVELS = (0.01, 0.1, 0.3, 0.6, 0.95)


def main() -> None:
    """Print a row of Markdown a case, and what was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what")
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--tries", default="3", help="of each")
    parser.add_argument("--minutes", type=float, default=1e6, help="of each, at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--folder", type=Path, default=Path(tempfile.gettempdir(), "tf_lab-reliability")
    )
    given = parser.parse_intermixed_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    cases, wrong = prepare_inputs(given.folder), 0
    for chosen in given.cases or cases:
        work = given.folder / "work" / given.what / chosen
        if given.what == "FULL":
            wrong += told(chosen, "FULL", full_disk(cases[chosen], work, LEVELS))
            continue
        known = watch(cases[chosen], work / "undisturbed")
        for what, tries in zip(given.what.split(","), cycle(given.tries.split(",")), strict=False):
            name, _, group = what.partition("-")
            how = (signal.Signals[f"SIG{name}"], int(tries), bool(group), given.seed, given.minutes)
            wrong += told(chosen, what, stopped(cases[chosen], known, work / what, *how))
    sys.exit(1 if wrong else 0)


def told(case: str, what: str, c: Counts) -> int:
    """Print what was counted; all that is wrong in it."""
    cells = [c.tries, c.early, c.status, c.lines, c.half, c.waited, c.orphans]
    cells += [f"{c.differ} of {c.compared}", f"{c.slowest:.1f}"]
    print(f"| {case} | {what} | {' | '.join(map(str, cells))} |", flush=True)
    print(f"{time.strftime('%H:%M')} UTC", *c.notes, sep="\n", file=sys.stderr)
    return c.wrong()


if __name__ == "__main__":
    main()
