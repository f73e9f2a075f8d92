"""Figures in one style, drawn off the screen and written whole or not at all.

Matplotlib takes a second to import: only who draws waits for it.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tf_lab.support.files import atomic_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 150
HEADING, TITLE, SMALL = 13, 10, 8  # points
PANEL = 3.1  # inches across
CHARACTERS = 12  # of a title an inch is wide enough for


def new_figure(width: float, height: float, dpi: float = DPI) -> Figure:
    """An empty figure of a size in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def panel_grid(panels: Mapping[str, np.ndarray], heading: str, columns: int) -> Figure:
    """Pictures (uint8 [H, W, 3], of one size) under their titles, so many in a line.

    Args:
        panels: by title.
        heading: of all.
        columns: at most so many.
    """
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    height, across = next(iter(panels.values())).shape[:2]
    figure = new_figure(PANEL * columns, (PANEL * height / across + 0.3) * rows + 0.5)
    figure.suptitle(heading, fontsize=HEADING, fontweight="bold")
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, (title, image) in zip(grid.flat, panels.items(), strict=False):
        axes.imshow(image)
        lines = [textwrap.fill(line, round(CHARACTERS * PANEL)) for line in title.splitlines()]
        axes.set_title("\n".join(lines), fontsize=TITLE)
    return figure


def write_figure(
    figure: Figure, path: Path, colors: int | None = None, format: str = "png", **how: Any
) -> None:
    """Write a figure on white.

    Args:
        figure: what to write.
        path: the file.
        colors: that a PNG is reduced to, which makes it small; None: it keeps all.
        format: "png" or "pdf".
        how: further arguments of `matplotlib.figure.Figure.savefig`.
    """
    import matplotlib
    from PIL import Image

    with atomic_path(path) as temporary, matplotlib.rc_context({"pdf.fonttype": 42}):
        figure.savefig(temporary, format=format, facecolor="white", **how)
        if colors:
            with Image.open(temporary) as whole:
                few = whole.convert("RGB").quantize(colors)
            few.save(temporary, format="png", optimize=True)
