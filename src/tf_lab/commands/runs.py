"""What trainings and evaluations there are, how far they are, who made them; removing them."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from tf_lab.errors import TFLabError
from tf_lab.evaluation.scores import format_table, read_metrics
from tf_lab.experiments.inventory import (
    Entry,
    find,
    find_runs,
    find_trainings,
    with_dependents,
)
from tf_lab.experiments.provenance import commits_of, sessions_of
from tf_lab.support.files import remove_directory
from tf_lab.support.layout import CONFIG, RUNS, TRAININGS
from tf_lab.support.tables import NOTHING, aligned
from tf_lab.support.text import read_text


def run(about: str) -> None:
    """List, show or remove, as the command line says.

    Args:
        about: what the command does; its third line is how it is called.
    """
    usage = about.splitlines()[2]

    def refuse(message: str) -> NoReturn:
        raise TFLabError(f"{message}; usage: {usage}")

    parser = argparse.ArgumentParser(
        prog="python -m tf_lab.runs",
        usage=usage,
        description=about,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("action", nargs="?", choices=("list", "show", "rm"), default="list")
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--output", type=_folder, default=Path("outputs"), metavar="DIR")
    parser.add_argument("--dry-run", action="store_true")
    words = [f"--{word}" if word.startswith("output=") else word for word in sys.argv[1:]]
    parser.error = refuse  # type: ignore[method-assign]
    try:
        given = parser.parse_intermixed_args(words)
        if bool(given.names) == (given.action == "list"):
            refuse(f"{given.action}: " + ("takes no NAME" if given.names else "of which NAME?"))
        if given.dry_run and given.action != "rm":
            refuse(f"{given.action}: takes no --dry-run")
        if given.action == "list":
            print(listing(given.output))
        entries = [find(given.output, name) for name in given.names]
        if given.action == "show":
            print("\n".join(map(details, entries)))
        if given.action == "rm":
            remove(entries, given.dry_run)
    except BrokenPipeError:  # whoever reads has seen enough
        os._exit(1)
    except (TFLabError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


def _folder(path: str) -> Path:
    return Path(os.path.expanduser(path))  # noqa: PTH111  # pathlib fails without such a user


def remove(entries: Sequence[Entry], dry_run: bool) -> None:
    """Remove trainings and evaluations and say so; or only say what would go.

    Raises:
        TFLabError: one is in use; then none is removed.
    """
    for path in dict.fromkeys(path for entry in entries for path in with_dependents(entry)):
        if not dry_run:
            remove_directory(path)
        print(f"{'would remove' if dry_run else 'removed'} {path}")


def listing(output: Path) -> str:
    """All trainings and evaluations as two tables.

    Raises:
        TFLabError: there are none.
    """
    trainings, runs = find_trainings(output), find_runs(output)
    if not trainings and not runs:
        raise TFLabError(
            f"{output}: no trainings or evaluations in it; give output=DIR, or make one by "
            "`python -m tf_lab.train`"
        )
    first = [["TRAINING", "STATE", "COMMIT", "DATA", "STEPS", "MINUTES", "USED BY (ROW / SEED)"]]
    for entry in trainings:
        labels = Counter(run.label for run in runs if run.training == entry.directory.name)
        used = [f"{label} ({n} times)" if n > 1 else label for label, n in labels.items()]
        seconds = entry.origin.get("seconds")
        minutes = f"{seconds / 60:.1f}" if seconds is not None else NOTHING
        first.append([*_start(entry, NOTHING), minutes, "; ".join(used)])
    second = [["EVALUATION", "STATE", "COMMIT", "DATA", "STEPS", "F-SCORE", "ROW / SEED"]]
    for entry in runs:
        score = f"{entry.fscore:.3f}" if entry.fscore is not None else NOTHING
        second.append([*_start(entry, NOTHING, tested=True), score, entry.label])
    tables = {TRAININGS: aligned(first, "l"), RUNS: aligned(second, "l")}
    parts = [f"{output / name}:\n{table}" for name, table in tables.items()]
    wrong = [line for entry in (*trainings, *runs) for line in entry.problems]
    return "\n\n".join([*parts, *(["cannot be read:\n" + "\n".join(wrong)] if wrong else [])])


def _start(entry: Entry, unknown: str = "", tested: bool = False) -> list[str]:
    state = entry.state + (f", {entry.user} works on it" if entry.user else "")
    makers = [o for o in (*sessions_of(entry.origin), entry.origin) if "commit" in o]
    config = entry.config
    of = [unknown, unknown]
    if config:
        of = [(config.tested if tested else config.data).name, str(config.optimizer.steps)]
    return [entry.directory.name, state, commits_of(makers) or unknown, *of]


def _without_configs(origin: Mapping[str, Any]) -> dict[str, Any]:
    """A provenance, of a training and of what that started from, too, without the settings."""
    return {
        name: _without_configs(value) if isinstance(value, dict) else value
        for name, value in origin.items()
        if name != "config"
    }


def details(entry: Entry) -> str:
    """All that is known of a training or an evaluation."""
    known_of_it = filter(None, [entry.label, *_start(entry)[1:3]])
    lines = [f"{entry.directory}: {', '.join(known_of_it)}"]
    metrics = read_metrics(entry.directory) if entry.state == "finished" else None
    if metrics is not None:
        rows = [*metrics.scenes.items(), (metrics.label, metrics.mean)]
        lines += ["", format_table(rows, "Scene")]
    known = _without_configs(entry.origin)
    lines += ["", "provenance:", json.dumps(known, indent=2)] if known else []
    lines += ["", "cannot be read:", *entry.problems] if entry.problems else []
    path = entry.directory / CONFIG
    if entry.config:
        lines += ["", "config:", read_text(path, "the settings of a run").rstrip()]
    return "\n".join(lines)
