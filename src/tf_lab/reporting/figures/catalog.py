"""Every figure by name, and drawing those that can be drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from tf_lab.errors import TFLabError
from tf_lab.reporting.charts import caption_of, rows_chart, save_chart, views_chart
from tf_lab.reporting.figures.contract import Drawn, Material
from tf_lab.reporting.figures.meshes import ablations, comparison, errors
from tf_lab.reporting.figures.rooms import room
from tf_lab.reporting.figures.runtimes import runtimes
from tf_lab.reporting.figures.views import best_views, selected_views
from tf_lab.support.figures import write_figure
from tf_lab.support.files import write_text
from tf_lab.support.progress import progress_bar

Draw = Callable[[Material], Drawn]


def _by_k(material: Material) -> Drawn:
    study = material.study()
    return Drawn(views_chart(study), caption_of("F-score against K", study), chart=True)


def _by_row(material: Material) -> Drawn:
    study = material.study()
    return Drawn(rows_chart(study), caption_of("F-score of every row", study), chart=True)


FIGURES: Mapping[str, Draw] = {
    "views": lambda material: best_views(material.shown()),
    "selected": lambda material: selected_views(material.shown(), material.points),
    "comparison": lambda material: comparison(material.compared()),
    "ablations": lambda material: ablations(material.ablations()),
    "errors": lambda material: errors(material.compared()[0]),
    "room": lambda material: room(material.shown()),
    "fscore_k": _by_k,
    "fscore_rows": _by_row,
    "runtimes": lambda material: runtimes(material.runtimes()),
}


def draw_figures(
    names: Sequence[str], material: Material, folder: Path
) -> tuple[list[Path], list[str]]:
    """Draw figures: NAME.png, of a chart NAME.pdf too, and NAME.txt, its caption.

    Returns:
        The files of those that were drawn, and lines on those that were not, with the reason.
    """
    files: list[Path] = []
    left_out: dict[str, list[str]] = {}
    with progress_bar() as bar:
        task = bar.add_task("drawing", total=len(names))
        for name in names:
            bar.update(task, description=f"drawing {name}")
            try:
                drawn = FIGURES[name](material)
                files += _write(drawn, folder / name)
            except TFLabError as error:
                left_out.setdefault(str(error), []).append(name)
            bar.advance(task)
    return files, [f"no {', '.join(each)}: {why}" for why, each in left_out.items()]


def _write(drawn: Drawn, path: Path) -> list[Path]:
    """Write a figure and its caption, ``path`` without the suffix; what was written."""
    if drawn.chart:
        save_chart(drawn.figure, path)
    else:
        write_figure(drawn.figure, path.with_suffix(".png"))
    write_text(path.with_suffix(".txt"), drawn.caption + "\n")
    return [path.with_suffix(s) for s in ((".png", ".pdf") if drawn.chart else (".png",))]
