"""The curves of a training as a picture."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tf_lab.errors import TFLabError
from tf_lab.support.figures import new_figure, write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOSSES = {
    "train/loss": ("total", "#222222"),
    "train/coarse": ("coarse mask", "#1b9e77"),
    "train/fine": ("fine mask", "#d95f02"),
    "train/occupancy": ("occupancy", "#7570b3"),
}


def loss_curve(csv_paths: Sequence[Path], path: Path) -> None:
    """Draw the losses, and val/fscore where it was logged, of Lightning's metrics.csv as a PNG.

    Several files are one run that was interrupted; their steps follow each other.

    Columns that are absent and cells that are blank are passed over.

    Raises:
        TFLabError: the file cannot be read or has none of the known columns.
    """
    rows: list[dict[str, str]] = []
    for csv_path in csv_paths:
        try:
            with csv_path.open(newline="") as file:
                rows += csv.DictReader(file)
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise TFLabError(f"{csv_path}: cannot be read as CSV ({error})") from error
    losses = {key: _series(rows, key) for key in LOSSES}
    losses = {key: series for key, series in losses.items() if len(series)}
    score = _series(rows, "val/fscore")
    if not losses and not len(score):
        names = ", ".join(str(p) for p in csv_paths)
        raise TFLabError(f"{names}: none of {', '.join(LOSSES)}, val/fscore was logged")
    count = bool(losses) + bool(len(score))
    figure = new_figure(5.5 * count, 3.6)
    axes = list(np.ravel(figure.subplots(1, count)))
    if losses:
        _draw_losses(axes[0], losses)
    if len(score):
        axes[-1].plot(score[:, 0], score[:, 1], "o-", color="#1f78b4", markersize=3)
        axes[-1].set(xlabel="step", ylabel="F-score (validation)", ylim=(0, None))
    for ax in axes:
        ax.grid(alpha=0.25)
        ax.spines[["top", "right"]].set_visible(False)
    write_figure(figure, path)


def _series(rows: list[dict[str, str]], key: str) -> np.ndarray:
    """The finite (step, value) pairs of a column, by step: [N, 2]."""
    pairs = []
    for row in rows:
        try:
            pair = (float(row["step"]), float(row[key]))
        except (KeyError, TypeError, ValueError):  # another metric's row, or one cut short
            continue
        if all(map(math.isfinite, pair)):
            pairs.append(pair)
    return np.array(sorted(pairs)).reshape(-1, 2)


def _draw_losses(axes: Axes, losses: dict[str, np.ndarray]) -> None:
    """Thin raw lines, and bold running means over a fortieth of the curve on each side."""
    from scipy.ndimage import uniform_filter1d

    for key, series in losses.items():
        label, color = LOSSES[key]
        mean = uniform_filter1d(series[:, 1], 2 * (len(series) // 40) + 1)
        axes.plot(series[:, 0], series[:, 1], color=color, alpha=0.2, linewidth=0.7)
        axes.plot(series[:, 0], mean, color=color, linewidth=1.8, label=label)
    if all((series[:, 1] > 0).all() for series in losses.values()):
        axes.set_yscale("log")
    axes.set(xlabel="step", ylabel="loss (training)")
    axes.legend(frameon=False)
