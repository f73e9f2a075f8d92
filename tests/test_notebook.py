"""The notebook of the results, executed on made-up runs."""

from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from PIL import Image

from helpers.made_up_runs import ROWS, write_study
from tf_lab.reporting.paper import SCORES

NOTEBOOK = Path(__file__).resolve().parents[1] / "notebooks" / "results.ipynb"
PICTURES = NOTEBOOK.parents[1] / "results" / "flats" / "pictures"


def execute(
    folder: Path, parameters: str | None = None, errors: bool = False
) -> nbformat.NotebookNode:
    """The notebook as it is after running in a folder, with other parameters or its own."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    metadata = notebook.metadata.copy()
    if parameters is not None:
        (cell,) = [c for c in notebook.cells if "parameters" in c.metadata.get("tags", [])]
        cell.source = parameters
    client = NotebookClient(
        notebook,
        timeout=120,
        kernel_name="python3",
        allow_errors=errors,
        record_timing=False,
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute()
    notebook.metadata = metadata  # the kernel adds versions
    return notebook


def refresh() -> None:
    """Run the notebook where it lies and keep what it shows."""
    nbformat.write(execute(NOTEBOOK.parent), NOTEBOOK)


def shown(notebook: nbformat.NotebookNode) -> dict[str, list[Any]]:
    """What each code cell shows: its texts, and of images only that they are there."""
    return {
        cell.id: [
            output.get("text")
            or {k: v if k.startswith("text/") else "" for k, v in output.get("data", {}).items()}
            for output in cell.outputs
        ]
        for cell in notebook.cells
        if cell.cell_type == "code"
    }


@pytest.fixture(scope="module")
def executed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[nbformat.NotebookNode]]:
    """What each code cell shows."""
    folder = tmp_path_factory.mktemp("notebook")
    write_study(folder, {row: SCORES[row]["fscore"] for row in ROWS})
    (folder / "pictures").mkdir()
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(folder / "pictures" / "room.png")
    notebook = execute(folder, 'runs = "runs"\npictures = "pictures"')
    return {cell.id: cell.outputs for cell in notebook.cells if cell.cell_type == "code"}


def test_what_is_committed_is_up_to_date() -> None:
    committed = nbformat.read(NOTEBOOK, as_version=4)
    assert shown(committed) == shown(execute(NOTEBOOK.parent)), (
        "notebooks/results.ipynb shows something else now; write it again by: "
        "python tests/test_notebook.py"
    )


def test_it_is_committed_with_its_outputs_and_small() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    outputs = [o for c in notebook.cells for o in c.get("outputs", [])]
    kinds = [kind for output in outputs for kind in output.get("data", {})]
    assert kinds.count("image/png") == 2  # charts
    assert kinds.count("image/jpeg") == len(list(PICTURES.glob("*.png"))) == 2
    assert kinds.count("text/markdown") == 10  # what the study is, and tables
    assert not any(o.output_type == "error" or o.get("name") == "stderr" for o in outputs)
    assert NOTEBOOK.stat().st_size < 1_000_000


def test_it_is_committed_without_machine_paths() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    text = NOTEBOOK.read_text()
    assert not any(place in text for place in (str(NOTEBOOK.parents[1]), "/work/", "/home/"))
    for cell in notebook.cells:
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
    for name, kind in (("chart-views", "png"), ("chart-rows", "png"), ("pictures", "jpeg")):
        (output,) = executed[name]
        assert f"image/{kind}" in output.data


def test_without_runs_it_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    notebook = execute(tmp_path, 'runs = "runs"', errors=True)
    (cell,) = [cell for cell in notebook.cells if cell.id == "open"]
    (error,) = [output for output in cell.outputs if output.output_type == "error"]
    (line,) = error.traceback
    assert line.startswith("error: no finished run in runs; run: python -m tf_lab.train")


if __name__ == "__main__":
    refresh()
