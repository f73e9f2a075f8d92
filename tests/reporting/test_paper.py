"""The paper's numbers are those of its LaTeX source, and of one piece."""

import re
from pathlib import Path

import pytest

from tf_lab.evaluation import PAPER
from tf_lab.evaluation.scores import Scores
from tf_lab.reporting import paper

SOURCE = Path(__file__).resolve().parents[3] / "shared" / "paper" / "transformerfusion.tex"


@pytest.fixture(scope="module")
def printed() -> list[dict[str, list[float]]]:
    """The numbers of the paper's tabulars by row, in its order."""
    if not SOURCE.is_file():
        pytest.skip(f"the paper's LaTeX source is not here ({SOURCE})")
    text = SOURCE.read_text(encoding="utf-8")
    found = []
    for body in re.findall(r"\\begin\{tabular\}.*?\n(.*?)\\end\{tabular\}", text, re.DOTALL):
        rows = {}
        for line in body.splitlines():
            name, *cells = re.sub(r"\s*\\cite\{.*?\}", "", line).strip().rstrip("\\").split("&")
            numbers = [re.search(r"\d+\.\d+", cell) for cell in cells]
            if cells and all(numbers):
                rows[name.strip()] = [float(number[0]) for number in numbers if number]
        found.append(rows)
    return found


@pytest.mark.parametrize(("index", "table"), [(0, paper.MAIN), (1, paper.INPUTS)])
def test_scores_are_the_printed_ones(
    printed: list[dict[str, list[float]]], index: int, table: list[dict[str, Scores]]
) -> None:
    held = {row: [*scores.values()] for group in table for row, scores in group.items()}
    assert list(held.items()) == list(printed[index].items())  # in the same order, too


@pytest.mark.parametrize(("index", "held"), [(2, paper.FRAME_MS), (3, paper.CHUNK_MS)])
def test_times_are_the_printed_ones(
    printed: list[dict[str, list[float]]], index: int, held: dict[str, float]
) -> None:
    assert [[value] for value in held.values()] == [*printed[index].values()]


def test_speeds_are_the_printed_ones(printed: list[dict[str, list[float]]]) -> None:
    text = SOURCE.read_text(encoding="utf-8")
    found = re.search(
        r"\$(\d+\.\d+)\$~FPS for \$16\$ views to \$(\d+\.\d+)\$~FPS for \$8\$ and to "
        r"\$(\d+\.\d+)\$~FPS for \$4\$",
        text,
    )
    assert found
    assert [paper.FPS[k] for k in (16, 8, 4)] == [float(number) for number in found.groups()]


def test_the_rows() -> None:
    assert len(paper.MAIN[0]) == 10
    assert len(paper.ABLATIONS) == 11
    assert all(list(scores) == list(PAPER) for scores in paper.SCORES.values())
    assert paper.INPUTS[-1] == paper.MAIN[-1]
    assert {*paper.ATTENTION.values(), *paper.RANDOM.values()} <= {*paper.ABLATIONS, paper.OURS}


def test_chamfer_is_the_mean_of_its_halves() -> None:
    """A check of every row against typing errors: the paper rounds each of the three."""
    for row, scores in paper.SCORES.items():
        half = (scores["acc"] + scores["compl"]) / 2
        assert scores["chamfer"] == pytest.approx(half, abs=0.0101), row
