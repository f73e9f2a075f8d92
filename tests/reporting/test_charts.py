"""The charts draw the study's numbers, whatever is missing."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from PIL import Image

from helpers.made_up_runs import ROWS, change_scores, write_run, write_study
from tf_lab.reporting.charts import rows_chart, save_chart, views_chart
from tf_lab.reporting.paper import ATTENTION, RANDOM, SCORES
from tf_lab.reporting.studies import Study, open_study

MEANS = {row: SCORES[row]["fscore"] + 0.05 for row in ROWS}


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return open_study([write_study(tmp_path_factory.mktemp("outputs"), MEANS)])[0]


def lines(axes: Axes) -> list[np.ndarray]:
    """The points [N, 2] of the lines that have error bars."""
    return [np.asarray(bars[0].get_xydata(), float) for bars in axes.containers]


def test_fscore_against_views(study: Study) -> None:
    here, there = views_chart(study).axes
    for axes, offset in ((here, 0.05), (there, 0)):
        for rows, points in zip((ATTENTION, RANDOM), lines(axes), strict=True):
            np.testing.assert_allclose(points[:, 0], [4, 8, 16], rtol=0.05)
            expected = [SCORES[row]["fscore"] + offset for row in rows.values()]
            np.testing.assert_allclose(points[:, 1], expected)
    assert "3 seeds, 4 test scenes" in here.get_title()


def test_a_selection_of_ours_is_drawn_where_it_was_run(study: Study, tmp_path: Path) -> None:
    assert len(lines(views_chart(study).axes[0])) == 2
    for k in (4, 8, 16):
        write_run(tmp_path, f"views={k} select=diverse", 0, [0.5 + k / 100])
    here, there = views_chart(open_study([tmp_path])[0]).axes
    (points,) = lines(here)
    np.testing.assert_allclose(points, [(4, 0.54), (8, 0.58), (16, 0.66)], rtol=1e-6)
    assert len(lines(there)) == 2  # the paper's
    legend = here.get_legend()
    assert legend and [text.get_text() for text in legend.get_texts()] == ["diverse (ours)"]


def test_the_seeds_named_are_of_the_rows_shown(tmp_path: Path) -> None:
    for seed in range(2):
        for k in (4, 8):
            write_run(tmp_path, f"views={k}", seed, [0.5 + k / 100])
    write_run(tmp_path, "fusion=avg", 0, [0.4])
    study = open_study([tmp_path])[0]
    assert "(2 seeds, 1 test scene)" in views_chart(study).axes[0].get_title()
    assert "(1 to 2 seeds, 1 test scene)" in rows_chart(study).axes[0].get_xlabel()


def test_fscore_of_every_row(study: Study) -> None:
    (axes,) = rows_chart(study).axes
    labels = [label.get_text() for label in axes.get_yticklabels()]
    order = [*ROWS]
    assert labels == [row.removeprefix("Ours: ") for row in order]
    (means,) = lines(axes)
    np.testing.assert_allclose(means, [(MEANS[row], i) for i, row in enumerate(order)])


def test_what_is_missing(tmp_path: Path) -> None:
    write_run(tmp_path, "views=4", 0, [0.5])
    write_run(tmp_path, "fusion=avg refine=false", 0, [0.4])
    change_scores(write_run(tmp_path, "views=8", 0, [0.5]), "fscore")
    study, _ = open_study([tmp_path])
    (axes,) = rows_chart(study).axes
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert sum("(missing)" in label for label in labels) == 11
    assert len(labels) == 13
    np.testing.assert_allclose(lines(axes)[0][:, 0], [0.5, 0.4])
    save_chart(rows_chart(study), tmp_path / "rows")
    save_chart(views_chart(study), tmp_path / "views")


def test_no_row_of_the_chart_was_run(tmp_path: Path) -> None:
    """It says so, in place of an empty half."""
    write_run(tmp_path, "fusion=avg", 0, [0.4])
    here, there = views_chart(open_study([tmp_path])[0]).axes
    assert [text.get_text() for text in here.texts] == ["no run of these rows"]
    assert len(lines(there)) == 2 and not there.texts


def test_a_single_row_is_alone(tmp_path: Path) -> None:
    write_run(tmp_path, "views=4", 0, [0.5])
    (axes,) = rows_chart(open_study([tmp_path])[0]).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["4 images"]


def test_files(study: Study, tmp_path: Path) -> None:
    save_chart(views_chart(study), tmp_path / "a" / "chart")
    with Image.open(tmp_path / "a" / "chart.png") as picture:
        assert picture.width > 1000
        assert np.asarray(picture.convert("L")).std() > 10
    assert (tmp_path / "a" / "chart.pdf").read_bytes().startswith(b"%PDF")
    save_chart(views_chart(study), tmp_path / "b" / "chart")
    for suffix in (".png", ".pdf"):  # committed charts change only if the study does
        one, other = (tmp_path / folder / f"chart{suffix}" for folder in "ab")
        assert one.read_bytes() == other.read_bytes()
