"""`python -m tf_lab.figures` as a user runs it."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.made_up_runs import ROWS, write_study
from helpers.tiny_jobs import TINY, call, told
from tf_lab.cli.command import TRAINING_DATA
from tf_lab.reporting.paper import SCORES

# all cells are decoded, so that a hardly trained network gives some surface
SETTINGS = ("resolution=0.05", "threshold=0", "device=cpu")
ROOM = tuple(
    option
    for option in TINY
    if option.startswith("data.") and option.partition("=")[0] not in TRAINING_DATA
)


def test_of_a_network(checkpoint: Path, tmp_path: Path) -> None:
    """Of a test room; the scenes of its data are there, a benchmark is not."""
    names = ("views", "selected", "comparison", "errors", "room", "runtimes")
    given = (f"figures=[{','.join(names)}]", f"checkpoint={checkpoint}", "frames=3", "output=drawn")
    done = call("figures", *given, *SETTINGS, *ROOM)
    assert (done.status, done.err) == (0, "")
    *_, missing, files = done.out.splitlines()
    assert missing.startswith("no runtimes: outputs/benchmark/benchmark.json: no such file; run ")
    assert files == "drawn: " + ", ".join(f"{name}.png" for name in names[:-1]), done.out
    for name in names[:-1]:
        with Image.open(tmp_path / "drawn" / f"{name}.png") as picture:
            assert np.asarray(picture.convert("L")).std() > 5
        caption = (tmp_path / "drawn" / f"{name}.txt").read_text()
        assert "room_2000000" in caption
        assert ("the same 3 frames" in caption) == (name in ("comparison", "errors"))


def test_of_a_study(tmp_path: Path) -> None:
    write_study(tmp_path / "outputs", {row: SCORES[row]["fscore"] for row in ROWS})
    done = call("figures", "figures=[fscore_k,fscore_rows]")
    assert (done.status, done.err) == (0, "")
    drawn = {path.name for path in (tmp_path / "outputs" / "figures").iterdir()}
    assert drawn == {f"fscore_{n}.{s}" for n in ("k", "rows") for s in ("png", "pdf", "txt")}


def test_nothing_to_draw() -> None:
    told(call("figures", "figures=[fscore_k]"), "no fscore_k: outputs/runs: there is no such")
    told(call("figures", "figures=[nope]"), "figures=[nope]: there is no such figure; there are")
    told(call("figures", "input=a", "run=b"), "give one of input= and run=")


@pytest.mark.parametrize("points", ["[[1,2]]", "[a]", "[[1,2,nan]]", "[]", "7"])
def test_points_that_are_none(points: str) -> None:
    result = call("figures", "figures=[selected]", f"points={points}", "input=/nowhere")
    assert result.status == 2
    assert result.err.startswith("error: points=") and "give [[x,y,z],...], metres" in result.err


@pytest.mark.parametrize("given", ["run", "input"])
def test_what_is_not_there_is_not_replaced_by_another_study(given: str, tmp_path: Path) -> None:
    write_study(tmp_path, dict.fromkeys(ROWS, 0.5))
    done = call("figures", f"{given}=nowhere", f"runs={tmp_path / 'runs'}", f"output={tmp_path}")
    assert done.status == 2
    assert "nowhere" in done.err and len(done.err.splitlines()) == 1
    assert not [*tmp_path.glob("*.pdf")]


def test_points_may_be_whole_numbers() -> None:
    """What is wrong here is the input, which is looked at after the points."""
    result = call("figures", "figures=[selected]", "points=[[1,0.5,1]]", "input=/nowhere")
    assert "/nowhere: no such folder" in result.err
