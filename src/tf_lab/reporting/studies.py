"""Studies: runs that differ in nothing but the row and the seed, and so may share a table."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tf_lab.errors import TFLabError
from tf_lab.evaluation.registry import PAPER, MetricPart, metric_columns
from tf_lab.experiments.identity import key_of
from tf_lab.experiments.provenance import commits_of
from tf_lab.reporting.paper import ABLATIONS, OURS
from tf_lab.reporting.results import Run, find_runs
from tf_lab.support.words import counted, natural

SHOWN_DIFFERENCES = 4


@dataclass(frozen=True)
class Study:
    """Comparable runs.

    Attributes:
        settings: what all share, by dotted name.
        runs: by row and seed.
        superseded: one line on each run that a newer one of its row and seed replaces.
        others: those of other settings whose scores compare: of the same scenes, and of its rows.
    """

    settings: dict[str, Any]
    runs: dict[tuple[str, int], Run]
    superseded: tuple[str, ...] = ()
    others: tuple[Study, ...] = ()

    @cached_property
    def key(self) -> str:
        """A short hash of the settings."""
        return key_of(self.settings)

    @cached_property
    def rows(self) -> list[str]:
        """The rows that have runs: the paper's in its order, then any others by their names."""
        found = {row for row, _ in self.runs}
        others = sorted(found.difference(ABLATIONS, (OURS,)), key=natural)
        return [row for row in (*ABLATIONS, OURS, *others) if row in found]

    @property
    def missing(self) -> list[str]:
        """The paper's rows that have no run."""
        return [row for row in (*ABLATIONS, OURS) if row not in self.rows]

    @property
    def alone(self) -> bool:
        """Whether all runs are of one row, so that there is nothing to compare."""
        return len(self.rows) == 1

    def shows(self, row: str) -> bool:
        """Whether tables and charts have a row: also one without a run, where rows are compared."""
        return row in self.rows or not self.alone

    @property
    def scenes(self) -> list[str]:
        """The test scenes."""
        return list(self.settings["test.scenes"])

    @cached_property
    def metrics(self) -> list[MetricPart]:
        """The metrics that any run has, as columns of a table: the paper's first."""
        scenes = (scores for run in self.runs.values() for scores in run.scenes.values())
        return metric_columns(name for scores in scenes for name in scores)

    @property
    def repetitions(self) -> tuple[int, int]:
        """The least and the most seeds that a row has runs of."""
        counts = [len(self.seeds(row)) for row in self.rows]
        return min(counts), max(counts)

    def compares(self, other: Study) -> bool:
        """Whether the other's scores are of the same scenes, and of any of the same rows."""
        mine, theirs = self.settings, other.settings
        test = ("test.scenes", "test.protocol", "test.content.test", "test.content.groundtruth")
        versions = [n for n in mine.keys() & theirs if n.startswith("content.versions.")]
        alike = all(mine.get(name) == theirs.get(name) for name in (*test, *versions))
        data = {s.get("test.data.name", s.get("data.name")) for s in (mine, theirs)}
        return alike and len(data) == 1 and not {*self.rows}.isdisjoint(other.rows)

    def seeds(self, *rows: str, metric: str | None = None) -> list[int]:
        """The seeds for which there are runs of all these rows (of any row, without one).

        With a metric, only runs count that have it for every scene.
        """
        having: dict[int, set[str]] = defaultdict(set)
        for (row, seed), run in self.runs.items():
            if metric is None or all(metric in scores for scores in run.scenes.values()):
                having[seed].add(row)
        return sorted(seed for seed, found in having.items() if found.issuperset(rows))

    def scores(
        self, row: str, metric: str = "fscore", seeds: Sequence[int] | None = None
    ) -> np.ndarray:
        """A metric of a row: [seeds, scenes]; of all seeds that have it, unless some are given."""
        chosen = self.seeds(row, metric=metric) if seeds is None else seeds
        values = [
            [self.runs[row, seed].scenes[scene][metric] for scene in self.scenes] for seed in chosen
        ]
        return np.array(values).reshape(len(chosen), len(self.scenes))


def open_study(folders: Iterable[Path | str], key: str | None = None) -> tuple[Study, list[str]]:
    """The study with the most runs under some folders, or the one asked for.

    Args:
        folders: folders of runs, such as ``outputs/runs``.
        key: start of the study's key.

    Returns:
        The study, and remarks on it, one a line: what was left out and why, and what is mixed.

    Raises:
        TFLabError: there is no run, or no study of this key.
    """
    runs, remarks = find_runs([Path(folder) for folder in folders])
    studies = group(runs)
    chosen = [study for study in studies if study.key.startswith(key or "")]
    if not chosen:
        keys = ", ".join(study.key for study in studies)
        raise TFLabError(f"study={key}: there is no such study; there are: {keys}")
    study = chosen[0]
    remarks += study.superseded
    others = [other for other in studies if other is not study]
    compared = tuple(other for other in others if study.compares(other))
    for other in others:
        what = differences(other.settings, study.settings)
        told = "; its scores are in the table of settings" if other in compared else ""
        size = counted(len(other.runs), "run")
        remarks.append(f"left out: study {other.key}, {size}, with {what}{told}")
    return replace(study, others=compared), [*remarks, *_lacking(study), *_mixture(study)]


def group(runs: Iterable[Run]) -> list[Study]:
    """Comparable runs together, most runs first (of equals, the newest)."""
    by_key: dict[str, list[Run]] = defaultdict(list)
    for run in runs:
        by_key[key_of(run.settings)].append(run)
    studies = []
    for members in by_key.values():
        chosen: dict[tuple[str, int], Run] = {}
        lines = []
        replaced = set()  # tested networks, by row
        for run in sorted(members, key=lambda run: run.finished):
            older = chosen.get((run.row, run.seed))
            copied = older is not None and older.scenes == run.scenes
            if copied and not run.config.tested.root:  # kept without its meshes
                continue
            chosen[run.row, run.seed] = run
            replaced.discard((run.row, run.config.content.init))  # tested again since
            if older and older.config.content.init != run.config.content.init:
                replaced.add((run.row, older.config.content.init))
            if older and not copied:
                lines.append(
                    f"{run.row}, seed {run.seed}: {_named(run)} counts, the older {_named(older)} "
                    "does not"
                )
        for (row, seed), run in [*chosen.items()]:
            if (row, run.config.content.init) in replaced:  # no mean is over both networks
                del chosen[row, seed]
                lines.append(
                    f"{row}, seed {seed}: {_named(run)} does not count, for another seed of this "
                    "network was replaced by a newer one"
                )
        if chosen:
            studies.append(Study(members[0].settings, chosen, tuple(lines)))
    studies.sort(key=lambda s: (len(s.runs), max(r.finished for r in s.runs.values())))
    return studies[::-1]


def _named(run: Run) -> str:
    return f"{run.directory} (commit {commits_of(run.makers[:1])})"


def differences(settings: dict[str, Any], reference: dict[str, Any]) -> str:
    """In which settings one differs from another, in a line: digests last, what data first.

    Of a part of another kind (an encoder, say), what only one of the two kinds has goes unsaid.
    """
    absent = "nothing"
    both = settings.keys() & reference.keys()
    kinds = [n for n in both if n.endswith(".name") and settings[n] != reference[n]]
    unlike = tuple(name.removesuffix("name") for name in kinds)
    names = sorted(
        {*both, *(n for n in settings.keys() ^ reference.keys() if not n.startswith(unlike))},
        key=lambda name: (name.startswith("content."), not name.endswith("data.name"), name),
    )
    lines = [
        f"{name} {_short(settings.get(name, absent))} (not {_short(reference.get(name, absent))})"
        for name in names
        if settings.get(name, absent) != reference.get(name, absent)
    ]
    more = len(lines) - SHOWN_DIFFERENCES
    return ", ".join(lines[:SHOWN_DIFFERENCES]) + (f" and {more} more" if more > 0 else "")


def _short(value: Any) -> str:
    return f"{len(value)} of them" if isinstance(value, list) and len(value) > 4 else str(value)


def _lacking(study: Study) -> list[str]:
    """A line on each run without one of the paper's metrics: it is in no mean of that."""
    lines = []
    for (row, seed), run in study.runs.items():
        scores = run.scenes.values()
        if lacks := [name for name in PAPER if any(name not in each for each in scores)]:
            lines.append(
                f"{row}, seed {seed}: {_named(run)} lacks {', '.join(lacks)} of a scene; it does "
                "not count there"
            )
    return lines


def _mixture(study: Study) -> list[str]:
    """A remark if the runs were not all made by the same code."""
    makers = [maker for run in study.runs.values() for maker in run.makers]
    if len({maker.get("code", maker.get("commit")) for maker in makers}) < 2:
        return []
    return [f"not all runs were made by the same code: commits {commits_of(makers)}"]
