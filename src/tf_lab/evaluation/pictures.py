"""Pictures of reconstructions beside the ground truth, as PNG files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from tf_lab.errors import TFLabError
from tf_lab.evaluation.truth import Truth
from tf_lab.meshes.raycast import CLAY, cast, overview_camera, render_mesh, shade
from tf_lab.support.colors import ERROR_COLORS, ERROR_SCALE, error_colors
from tf_lab.support.figures import new_figure, write_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure, FigureBase


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
        errors = Truth(groundtruth).distances(seen.points, ERROR_SCALE)  # colours say no more
        colors = error_colors(errors) / 255
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
    figure = new_figure(width, 0.9 + strip + panel)
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
        error_bar(bottom, row[-1:])
    return figure


def error_bar(figure: FigureBase, axes: Any) -> None:
    """The colour bar of errors, in cm, beside panels."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    scale = ScalarMappable(Normalize(0, 100 * ERROR_SCALE), ERROR_COLORS)
    bar = figure.colorbar(scale, ax=axes, shrink=0.6, aspect=25, extend="max", ticks=[0, 5, 10, 15])
    bar.set_label("cm")
