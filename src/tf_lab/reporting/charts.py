"""The paper's two charts of a study: F-score against K, and F-score of every row."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tf_lab.reporting.paper import ABLATIONS, ATTENTION, DIVERSE, OURS, RANDOM, SCORES
from tf_lab.reporting.statistics import deviation
from tf_lab.reporting.studies import Study
from tf_lab.support.colors import BLUE, GREEN, ORANGE
from tf_lab.support.figures import new_figure, write_figure
from tf_lab.support.words import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MEAN = "mean ± standard deviation"
SPREAD = "means, bars of the standard deviation over seeds, small dots for the seeds, "
# told apart by their markers in grey: name, rows, colour, marker, octaves of K to the right
SELECTIONS: tuple[tuple[str, dict[int, str], str, str, float], ...] = (
    ("attention", ATTENTION, BLUE, "o", -0.05),
    ("random", RANDOM, ORANGE, "s", 0.05),
    ("diverse (ours)", DIVERSE, GREEN, "^", 0.0),
)
DPI = 200


def views_chart(study: Study) -> Figure:
    """F-score against views kept a voxel, by how they are selected, beside the paper's.

    Dots are seeds, lines go through their means, and bars are the standard deviation.
    """
    figure = new_figure(7.0, 3.1, DPI)
    here, there = figure.subplots(1, 2, sharey=True)
    for name, rows, color, marker, shift in SELECTIONS:
        found = {k: s for k, row in rows.items() if len(s := study.scores(row).mean(1))}
        theirs = {k: np.array([SCORES[row]["fscore"]]) for k, row in rows.items() if row in SCORES}
        for axes, values in ((here, found), (there, theirs)):
            if values:
                _draw_line(axes, values, name, color, marker, shift)
    if not here.containers:
        nothing = "no run of these rows"
        here.text(0.5, 0.5, nothing, ha="center", transform=here.transAxes)
    shown = [row for _, rows, *_ in SELECTIONS for row in rows.values()]
    here.set(title=f"This study ({_repetitions(study, *shown)})", ylabel="F-score")
    there.set(title="Paper (ScanNet)")
    for axes in (here, there):
        axes.set_xscale("log", base=2)
        axes.set_xticks([*ATTENTION], [str(k) for k in ATTENTION])
        axes.set(xlabel="views kept a voxel, K", xlim=(3.4, 18.8))
        axes.minorticks_off()
    fullest = here if found else there  # the paper has no selection of ours
    fullest.legend(title="view selection", frameon=False, loc="best")
    return figure


def _draw_line(
    axes: Axes, values: Mapping[int, np.ndarray], name: str, color: str, marker: str, shift: float
) -> None:
    """Means over seeds [S] by K, with bars of their deviation, and the seeds as small dots.

    All is shifted by so many octaves of K, the dots by twice that, so that nothing is hidden.
    """
    places = np.array([*values]) * 2**shift
    means = [value.mean() for value in values.values()]
    spread = [_bar(value) for value in values.values()]
    bars = axes.errorbar(places, means, yerr=spread, label=name, color=color, capsize=3, zorder=3)
    bars[0].set(marker=marker, markersize=5, linewidth=1.6)
    for place, seeds in zip(places, values.values(), strict=True):
        if len(seeds) > 1:
            axes.plot([place * 2**shift] * len(seeds), seeds, ".", color=color, markersize=4)


def rows_chart(study: Study) -> Figure:
    """F-score of every row in the paper's order: mean, deviation, seeds, and the paper's value."""
    others = [row for row in study.rows if row not in SCORES]
    rows = [row for row in (*ABLATIONS, *others, OURS) if study.shows(row)]
    figure = new_figure(6.6, 0.9 + 0.33 * len(rows), DPI)
    axes = figure.subplots()
    found = {i: s for i, row in enumerate(rows) if len(s := study.scores(row).mean(1))}
    means = [seeds.mean() for seeds in found.values()]
    spread = [_bar(seeds) for seeds in found.values()]
    mean = MEAN if study.repetitions[1] > 1 else "mean over scenes"
    axes.errorbar(means, [*found], xerr=spread, fmt="o", color=BLUE, capsize=3, label=mean)
    dots = [(score, i) for i, seeds in found.items() for score in seeds if len(seeds) > 1]
    if dots:
        scores, heights = np.transpose(dots)
        axes.plot(scores, heights + 0.27, ".", color="black", markersize=4, label="a seed")
    theirs = {i: SCORES[row]["fscore"] for i, row in enumerate(rows) if row in SCORES}
    style: dict[str, Any] = {
        "color": ORANGE,
        "fillstyle": "none",
        "markersize": 5,
        "linestyle": "none",
    }
    above = np.array([*theirs]) - 0.27
    axes.plot([*theirs.values()], above, marker="D", label="paper (ScanNet)", **style)
    for i in range(0, len(rows), 2):
        axes.axhspan(i - 0.5, i + 0.5, color="0.955", zorder=0)
    missing = [" (missing)" * (i not in found) for i in range(len(rows))]
    labels = [f"{row.removeprefix('Ours: ')}{m}" for row, m in zip(rows, missing, strict=True)]
    axes.set_yticks(range(len(rows)), labels)
    axes.tick_params(axis="y", length=0)
    axes.set(xlabel=f"F-score ({_repetitions(study)})", ylim=(len(rows) - 0.5, -0.5))
    figure.legend(loc="outside upper center", ncols=3, frameon=False)
    return figure


def _bar(values: np.ndarray) -> float:
    """Half the length of an error bar; NaN, which draws none, of a single value."""
    found = deviation(values)
    return float("nan") if found is None else found


def _repetitions(study: Study, *rows: str) -> str:
    """How many seeds and scenes there are, of some rows or all."""
    counts = [len(study.seeds(row)) for row in rows if row in study.rows]
    least, most = (min(counts), max(counts)) if counts else study.repetitions
    seeds = counted(most, "seed") if least == most else f"{least} to {counted(most, 'seed')}"
    return f"{seeds}, {counted(len(study.scenes), 'test scene')}"


def caption_of(what: str, study: Study) -> str:
    """Of a chart of a study."""
    over = "" if study.repetitions[1] == 1 else SPREAD
    return (
        f"{what}, {_repetitions(study)} of study {study.key}: {over}beside the paper's values on "
        "ScanNet."
    )


def save_chart(figure: Figure, path: Path) -> None:
    """Write a chart as PNG and as PDF, ``path`` without the suffix; both only depend on it."""
    write_figure(figure, path.with_suffix(".png"))
    undated = {"CreationDate": None}
    write_figure(figure, path.with_suffix(".pdf"), format="pdf", metadata=undated)
