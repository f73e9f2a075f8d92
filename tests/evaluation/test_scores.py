"""Scores as they are printed and stored."""

from pathlib import Path

import pytest

from tf_lab.errors import TFLabError
from tf_lab.evaluation import PAPER
from tf_lab.evaluation.scores import Metrics, format_table, read_metrics, score

VALUES = dict(zip(PAPER, (5.517, 8.269, 6.893, 0.7284, 0.6, 0.6549), strict=True))


def test_rows_have_the_papers_columns_and_digits() -> None:
    lines = format_table([("Ours", VALUES), ("w/o a long name", score(None))]).splitlines()
    assert lines == [
        "Method               Acc    Compl  Chamfer     Prec   Recall  F-score",
        "-" * 69,
        "Ours                5.52     8.27     6.89    0.728    0.600    0.655",
        "w/o a long name   100.00   100.00   100.00    1.000    0.000    0.000",
    ]


def test_what_a_row_lacks_is_a_dash_and_what_it_has_more_follows() -> None:
    old = {name: value for name, value in VALUES.items() if name != "recall"}
    new = {**VALUES, "normals": 0.91234, "unheard_of": 2}
    heading, _, first, second = format_table([("old", old), ("new", new)], "Scene").splitlines()
    assert heading.split()[-3:] == ["F-score", "Normals", "unheard_of"]
    assert first.split() == ["old", "5.52", "8.27", "6.89", "0.728", "-", "0.655", "-", "-"]
    assert second.split()[-3:] == ["0.655", "0.912", "2.000"]


def test_stored_metrics(tmp_path: Path) -> None:
    assert read_metrics(tmp_path) is None
    (tmp_path / "metrics.json").write_text('{"mean": {"acc": 1}, "scenes": {"a": {"acc": 1}}}')
    assert read_metrics(tmp_path) == Metrics({"acc": 1.0}, {"a": {"acc": 1.0}})
    (tmp_path / "metrics.json").write_text("{")
    with pytest.raises(TFLabError, match=r"metrics\.json: damaged"):
        read_metrics(tmp_path)
