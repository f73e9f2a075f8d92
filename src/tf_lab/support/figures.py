"""Figures that are drawn off the screen and written whole or not at all.

Matplotlib takes a second to import: only who draws waits for it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from tf_lab.support.files import atomic_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 150


def new_figure(width: float, height: float, dpi: float = DPI) -> Figure:
    """An empty figure of a size in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
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
