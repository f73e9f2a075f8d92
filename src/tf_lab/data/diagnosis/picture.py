"""A check in one picture: matches with epipolar lines, the path from above, the errors."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from tf_lab.data.diagnosis.evidence import Evidence, Geometry
from tf_lab.data.diagnosis.verdict import Report
from tf_lab.errors import TFLabError
from tf_lab.support.figures import DPI, new_figure, write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN = 14  # matches of a pair
GIVEN, BEST = "#d95f02", "#1b9e77"


def draw(report: Report, evidence: Evidence, path: Path) -> None:
    """Write the picture of a check as PNG."""
    figure = new_figure(13, 12, DPI * 0.7)
    figure.suptitle(f"{evidence.capture.name}: {report.verdict}", fontsize=14, fontweight="bold")
    grid = figure.add_gridspec(3, 2, height_ratios=[1, 1, 1.1])
    given = evidence.geometry(evidence.settings) if evidence.pairs else None
    for line, row in enumerate(_typical(evidence)):
        axes = [figure.add_subplot(grid[line, column]) for column in range(2)]
        assert given is not None
        _draw_pair(axes, evidence, given, row)
    _draw_path(figure.add_subplot(grid[2, 0]), evidence)
    _draw_errors(figure.add_subplot(grid[2, 1]), report, evidence)
    write_figure(figure, path)


def _typical(evidence: Evidence) -> list[int]:
    """Two pairs, one of each half of the capture: of those not better than most, the richest."""
    errors = evidence.errors(evidence.geometry(evidence.settings))
    halves = [half for half in np.array_split(np.arange(len(errors)), 2) if len(half)]
    usual = [half[errors[half] >= np.median(errors[half])] for half in halves]
    return [
        int(max(some if len(some) else half, key=lambda row: len(evidence.pairs[row].a)))
        for some, half in zip(usual, halves, strict=True)
    ]


def _draw_pair(axes: list[Axes], evidence: Evidence, geometry: Geometry, row: int) -> None:
    """Matches of a pair; in the second image the lines on which they should lie."""
    pair = evidence.pairs[row]
    wide, high = evidence.capture.size
    for ax, index in zip(axes, (pair.i, pair.j), strict=True):
        try:
            grey = cv2.cvtColor(evidence.capture.image(index), cv2.COLOR_RGB2GRAY)
            ax.imshow(grey, cmap="gray", alpha=0.75)
        except TFLabError:
            pass
        ax.set(xlim=(-0.5, wide - 0.5), ylim=(high - 0.5, -0.5), xticks=[], yticks=[])
        ax.set_title(evidence.capture.frames[index], fontsize=10)
    error = evidence.errors(geometry)[row]
    axes[1].set_title(
        f"{evidence.capture.frames[pair.j]}: as given, median error {error:.2f} pixels", fontsize=10
    )
    lines = evidence.lines(geometry, row)
    chosen = np.linspace(0, len(pair.a) - 1, min(SHOWN, len(pair.a))).astype(int)
    for n, k in enumerate(chosen):
        color = f"C{n % 10}"
        axes[0].plot(*pair.a[k], "o", color=color, markersize=5, markeredgecolor="white")
        axes[1].plot(*pair.b[k], "o", color=color, markersize=5, markeredgecolor="white")
        a, b, c = lines[k]
        if np.isfinite(lines[k]).all() and max(abs(a), abs(b)) > 0:
            point = -c * np.array([a, b]) / (a * a + b * b)
            axes[1].axline(point, (point[0] + b, point[1] - a), color=color, linewidth=1)


def _draw_path(ax: Axes, evidence: Evidence) -> None:
    """The cameras from above, and where they look."""
    poses = evidence.capture.world_T_cam
    x, y = poses[:, 0, 3], poses[:, 1, 3]
    ax.plot(x, y, "-", color="#888888", linewidth=0.8)
    some = np.unique(np.linspace(0, len(poses) - 1, 60).astype(int))
    order = some / max(1, len(poses) - 1)
    ax.quiver(x[some], y[some], poses[some, 0, 2], poses[some, 1, 2], order, cmap="viridis",
              width=0.004, scale=18)  # fmt: skip
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_title("path from above, with view directions (dark: first)", fontsize=10)
    ax.set(xlabel="x (m)", ylabel="y (m)")
    ax.grid(alpha=0.25)


def _draw_errors(ax: Axes, report: Report, evidence: Evidence) -> None:
    """Histograms of the epipolar errors, as given and at the best."""
    if report.found is None:
        ax.set_axis_off()
        ax.text(0.5, 0.5, "too few matches", ha="center")
        return
    rows = [("as given", report.found.given, GIVEN)]
    if report.found.best is not report.found.given:
        rows.append((report.found.best.setting, report.found.best, BEST))
    bins = np.geomspace(0.02, max(100.0, evidence.capture.size[0] / 4), 50)
    for label, candidate, color in rows:
        distances = evidence.distances(evidence.geometry(candidate.settings))
        known = distances[np.isfinite(distances)].clip(bins[0], bins[-1])
        name = f"{label}: median {candidate.error:.2f}"
        ax.hist(known, bins.tolist(), histtype="stepfilled", alpha=0.55, color=color, label=name)
    ax.set_xscale("log")
    ax.set(
        xlabel="distance to the epipolar geometry (pixels; nearer ones in the first bar)",
        ylabel="matches",
    )
    ax.legend(frameon=False, fontsize=9)
    ax.spines[["top", "right"]].set_visible(False)
