"""Scores of scenes by metric: their mean, how they are stored, and the paper's table of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from tf_lab.evaluation.registry import METRICS, metric_columns, with_paper
from tf_lab.support.layout import SCORES
from tf_lab.support.records import read_record
from tf_lab.support.tables import NOTHING, aligned

if TYPE_CHECKING:
    from tf_lab.evaluation.metrics import Comparison

Scores = dict[str, float]


def score(found: Comparison | None, metrics: Sequence[Any] = ()) -> Scores:
    """The paper's metrics of a reconstruction, and further ones, by name.

    Args:
        found: the reconstruction beside the ground truth; None: it is missing or empty.
        metrics: settings of metrics beyond the paper's.
    """
    return {METRICS.named(each).name: value(found, each) for each in with_paper(metrics)}


def value(found: Comparison | None, settings: Any) -> float:
    """One metric of a reconstruction; see `score`."""
    return METRICS.named(settings).empty if found is None else float(METRICS.make(settings, found))


def mean_scores(scenes: Iterable[Mapping[str, float]]) -> Scores:
    """Mean of each metric over scenes; so the mean F-score is not the F-score of the means."""
    rows = list(scenes)
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


class Details(TypedDict, total=False):
    """How the scores of a scene came about, as far as somebody reads it."""

    view_sets: Scores


@dataclass(frozen=True)
class Metrics:
    """What ``metrics.json`` of a run holds.

    Attributes:
        mean: of each metric over scenes.
        scenes: scores by scene, at least one.
        label: the row's name.
        protocol: by which they were measured.
        details: how they came about, by scene.
    """

    mean: Scores
    scenes: dict[str, Scores]
    label: str = "mean"
    protocol: str | None = None
    details: dict[str, Details] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (self.scenes and self.mean and all(self.scenes.values())):
            raise ValueError("there is no scene, or no score, in it")


def read_metrics(run: Path) -> Metrics | None:
    """The ``metrics.json`` of a finished run; None if it is not finished.

    Raises:
        TFLabError: the file is damaged.
    """
    path = run / SCORES
    return read_record(Metrics, path, "delete it to evaluate again") if path.exists() else None


def format_table(rows: Sequence[tuple[str, Mapping[str, float]]], first: str = "Method") -> str:
    """The paper's table as aligned text, one (label, scores) a row: cm with 2 decimals.

    Metrics beyond the paper's follow; what a row lacks is "-". ``first`` is the heading of the
    labels' column.
    """
    parts = metric_columns(name for _, scores in rows for name in scores)
    cells = [
        [label, *(format(s[p.name], p.format) if p.name in s else NOTHING for p in parts)]
        for label, s in rows
    ]
    return aligned(cells, head=[first, *(part.heading for part in parts)], rule=True, width=7)
