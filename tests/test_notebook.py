"""The notebook of the results, executed on made-up runs."""

from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from PIL import Image

from made_up_runs import ROWS, write_study
from tf_lab.study.paper import SCORES

NOTEBOOK = Path(__file__).resolve().parents[1] / "notebooks" / "results.ipynb"


def execute(folder: Path, runs: str, errors: bool = False) -> nbformat.NotebookNode:
    """The notebook as it is after running in a folder, with other parameters."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    (cell,) = [c for c in notebook.cells if "parameters" in c.metadata.get("tags", [])]
    cell.source = f'runs = "{runs}"\npictures = "pictures"'
    client = NotebookClient(
        notebook,
        timeout=120,
        kernel_name="python3",
        allow_errors=errors,
        resources={"metadata": {"path": str(folder)}},
    )
    return client.execute()


@pytest.fixture(scope="module")
def executed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[nbformat.NotebookNode]]:
    """What each code cell shows."""
    folder = tmp_path_factory.mktemp("notebook")
    write_study(folder, {row: SCORES[row]["fscore"] for row in ROWS})
    (folder / "pictures").mkdir()
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(folder / "pictures" / "room.png")
    notebook = execute(folder, "runs")
    return {cell.id: cell.outputs for cell in notebook.cells if cell.cell_type == "code"}


def test_it_is_committed_without_machine_paths() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        assert "/work" not in cell.source and "/home" not in cell.source
        assert not any(word in cell.source for word in ("def ", "for i ", "while ", "import numpy"))


@pytest.mark.parametrize("name", ["main", "inputs", "comparison", "seeds", "scenes", "row"])
def test_tables(executed: dict[str, list[nbformat.NotebookNode]], name: str) -> None:
    (output,) = executed[name]
    assert "| Ours " in output.data["text/markdown"]


def test_what_else_it_shows(executed: dict[str, list[nbformat.NotebookNode]]) -> None:
    (opened,) = executed["open"]
    assert "36 runs of 12 rows" in opened.data["text/markdown"]
    counts, orderings = executed["orderings"]
    assert "11 of 11 hold in the mean" in counts.text
    assert orderings.data["text/markdown"].count("holds") > 20
    for name in ("chart-views", "chart-rows", "pictures"):
        (output,) = executed[name]
        assert "image/png" in output.data


def test_without_runs_it_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    notebook = execute(tmp_path, "runs", errors=True)
    (cell,) = [cell for cell in notebook.cells if cell.id == "open"]
    (error,) = [output for output in cell.outputs if output.output_type == "error"]
    (line,) = error.traceback
    assert line.startswith("error: no finished run in runs; run: python -m tf_lab.train")
