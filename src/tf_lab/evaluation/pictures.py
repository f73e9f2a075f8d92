"""Pictures of reconstructions and training curves, as PNG files."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from PIL import Image

from tf_lab.errors import TFLabError
from tf_lab.evaluation.metrics import distances
from tf_lab.meshes.raycast import CLAY, cast, overview_camera, render_mesh, shade
from tf_lab.support.files import atomic_path

ERROR_SCALE = 0.15  # metres at the end of the error panel's colour bar
ERROR_COLORS = "YlOrRd"
DPI = 150


def compare(
    prediction: trimesh.Trimesh,
    groundtruth: trimesh.Trimesh | None,
    frames: Sequence[np.ndarray],
    path: Path,
    title: str,
    fscore: float | None = None,
    size: tuple[int, int] = (640, 480),
    label: str = "Prediction",
) -> None:
    """Draw input frames above the prediction, the ground truth and the error, as one PNG.

    All panels share the camera. The error is the distance of each visible point of the prediction
    to the ground-truth surface, whether or not the surface was ever observed there.

    Args:
        prediction: mesh in metres; may be empty.
        groundtruth: mesh in metres; without it only the prediction is drawn.
        frames: uint8 [h, w, 3] images of one size; up to six, evenly chosen, are shown.
        path: the PNG to write.
        title: heading, for instance the scene's name.
        fscore: added to the heading if given.
        size: (width, height) of a panel, pixels.
        label: what the prediction is called.
    """
    reference = prediction if groundtruth is None else groundtruth
    if len(reference.faces) == 0:
        raise TFLabError(f"{path}: there is no surface to draw; the mesh is empty")
    K, world_T_cam, ceiling = overview_camera(reference.bounds, size)
    seen = cast(prediction, K, world_T_cam, size, ceiling)
    label = label if len(prediction.faces) else f"{label} (empty)"
    panels = [(label, shade(seen, np.array(CLAY)))]
    if groundtruth is not None:
        surface, _ = trimesh.sample.sample_surface(groundtruth, 200_000, seed=0)
        error = distances(seen.points, np.asarray(surface))
        colors = matplotlib.colormaps[ERROR_COLORS](error / ERROR_SCALE)[:, :3]
        panels.append(("Ground truth", render_mesh(groundtruth, K, world_T_cam, size, ceiling)))
        panels.append(("Distance to ground truth", shade(seen, colors)))
    heading = title if fscore is None else f"{title}    F-score {fscore:.3f}"
    write_figure(_compare_figure(frames, panels, heading), path)


def _compare_figure(
    frames: Sequence[np.ndarray], panels: list[tuple[str, np.ndarray]], heading: str
) -> Figure:
    count = min(len(frames), 6)
    chosen = [frames[int(i)] for i in np.linspace(0, len(frames) - 1, count).round()]
    width = 4.2 * len(panels)
    strip = width / 6 * chosen[0].shape[0] / chosen[0].shape[1] if chosen else 0.01
    panel = 4.2 * panels[0][1].shape[0] / panels[0][1].shape[1]
    figure = Figure(figsize=(width, 0.9 + strip + panel), dpi=DPI, layout="constrained")
    figure.suptitle(heading, fontsize=13, fontweight="bold")
    parts = figure.subfigures(2, 1, squeeze=False, height_ratios=[strip + 0.1, panel + 0.35])
    top, bottom = parts[:, 0]
    for axes, image in zip(np.ravel(top.subplots(1, 6)), [*chosen, *[None] * 6], strict=False):
        axes.set_axis_off()
        if image is not None:
            axes.imshow(image)
    row = np.ravel(bottom.subplots(1, len(panels)))
    for axes, (label, image) in zip(row, panels, strict=True):
        axes.imshow(image)
        axes.set_title(label, fontsize=11)
        axes.set_axis_off()
    if len(panels) > 1:
        scale = ScalarMappable(Normalize(0, 100 * ERROR_SCALE), ERROR_COLORS)
        bar = bottom.colorbar(
            scale, ax=row[-1], shrink=0.6, aspect=25, extend="max", ticks=[0, 5, 10, 15]
        )
        bar.set_label("cm")
    return figure


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
    figure = Figure(figsize=(5.5 * count, 3.6), dpi=DPI, layout="constrained")
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
    for key, series in losses.items():
        label, color = LOSSES[key]
        half = len(series) // 40
        total = np.concatenate([[0.0], np.cumsum(series[:, 1])])
        index = np.arange(len(series))
        first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, len(series))
        mean = (total[last] - total[first]) / (last - first)
        axes.plot(series[:, 0], series[:, 1], color=color, alpha=0.2, linewidth=0.7)
        axes.plot(series[:, 0], mean, color=color, linewidth=1.8, label=label)
    if all((series[:, 1] > 0).all() for series in losses.values()):
        axes.set_yscale("log")
    axes.set(xlabel="step", ylabel="loss (training)")
    axes.legend(frameon=False)


def write_figure(figure: Figure, path: Path, colors: int | None = None) -> None:
    """Write a figure as PNG on white, whole or not at all; with few colours it is small."""
    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", facecolor="white")
        if colors:
            with Image.open(temporary) as whole:
                few = whole.convert("RGB").quantize(colors)
            few.save(temporary, format="png", optimize=True)
