"""The figures of docs/reliability.md: commands disturbed so many times, and what that did.

    PYTHONPATH=src:tests python tests/reliability/campaign.py KILL --tries 25 [CASE ...]

KILL, TERM or INT; TERM-group and INT-group send it to all processes; FULL runs out of space.
"""

import argparse
import signal
import sys
import tempfile
import time
from pathlib import Path

from helpers.faults import full_disk, prepare_inputs, stopped

LEVELS = (0.01, 0.1, 0.3, 0.6, 0.95)


def main() -> None:
    """Print a row of Markdown a case, and what was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what")
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--tries", type=int, default=3)
    parser.add_argument("--minutes", type=float, default=1e6, help="a case, at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--folder", type=Path, default=Path(tempfile.gettempdir(), "tf_lab-reliability")
    )
    given = parser.parse_intermixed_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    cases, wrong = prepare_inputs(given.folder), 0
    name, _, group = given.what.partition("-")
    for chosen in given.cases or cases:
        case, work = cases[chosen], given.folder / "work" / given.what
        began = time.monotonic()
        if name == "FULL":
            c = full_disk(case, work, LEVELS)
        else:
            number = signal.Signals[f"SIG{name}"]
            c = stopped(case, work, number, given.tries, bool(group), given.seed, given.minutes)
        cells = [c.tries, c.early, c.status, c.lines, c.half, c.waited, c.orphans]
        cells += [f"{c.differ} of {c.compared}", f"{c.slowest:.1f}"]
        print(f"| {chosen} | {given.what} | {' | '.join(map(str, cells))} |", flush=True)
        print(f"{(time.monotonic() - began) / 60:.1f} minutes", *c.notes, sep="\n", file=sys.stderr)
        wrong += c.wrong()
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
