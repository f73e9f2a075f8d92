"""Every command with paths as people have them, and places that cannot be written to."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from helpers.made_up_runs import ROWS, write_study
from helpers.tiny_jobs import TINY, Result, call, told
from tf_lab.reporting.paper import SCORES

ODD = ["2024_01_01", "~/my Küche, (1) #a='b' ${x}"]


@pytest.fixture(params=ODD)
def odd(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A folder of this name, as it is given on the command line."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    Path(request.param.replace("~", "home")).mkdir(parents=True)
    return str(request.param)


def place(odd: str) -> Path:
    return Path(odd.replace("~", "home"))


def test_reconstruct(odd: str, posed_images: Path, checkpoint: Path) -> None:
    shutil.copytree(posed_images, place(odd) / "20240101")
    shutil.copy(checkpoint, place(odd) / "1e5")
    result = call(
        *("reconstruct", f"input={odd}/20240101", f"checkpoint={odd}/1e5", f"output={odd}/a,b.ply"),
        *("resolution=0.05", "threshold=0", "device=cpu"),
    )
    assert (result.status, result.err) == (0, "")
    assert (place(odd) / "a,b.ply").stat().st_size > 1000
    assert (place(odd) / "a,b.png").exists()


def test_evaluate(odd: str, box_scene: Path) -> None:
    scene = place(odd) / "true" / "room"
    shutil.copytree(box_scene / "groundtruth", scene)
    shutil.copy(scene / "mesh_gt.ply", place(odd) / "room.ply")
    result = call(
        "evaluate", f"predictions={odd}", f"groundtruth={odd}/true", f"output={odd}/=.json"
    )
    assert result.status == 0, result.err
    assert json.loads((place(odd) / "=.json").read_text())["mean"]["fscore"] > 0.99


def test_train(odd: str, cache: Path, main_job: Result) -> None:
    """The rooms are there; the training is this test's own."""
    assert main_job.status == 0
    (place(odd) / "1").symlink_to(cache)
    words = (*TINY, "optimizer.steps=1", f"data.root={odd}/1", f"output={odd}/2024")
    result = call("train", *words, "data.test_size=0")
    assert (result.status, result.err) == (0, "")
    assert len(list((place(odd) / "2024").glob("trainings/*/model.safetensors"))) == 1


def test_prepare(odd: str, box_scene: Path) -> None:
    """A list of names of which one looks like a number."""
    root = place(odd)
    for name in ("2024_05_01", "kitchen"):
        shutil.copytree(box_scene, root / name)
    result = call(
        *("prepare", "data=captures", f"data.root={odd}", "data.test=[2024_05_01,kitchen]"),
        *("splits=[test]", "data.workers=1", "data.width=64", "data.height=48"),
    )
    assert (result.status, result.err) == (0, ""), result.out
    assert {p.parts[-3] for p in root.glob("tf_lab/*/*/*/scene.json")} == {"2024_05_01", "kitchen"}


def test_report(odd: str) -> None:
    write_study(place(odd), {row: SCORES[row]["fscore"] for row in ROWS})
    result = call("report", f"runs={odd}/runs", f"output={odd}/true", "pictures=false")
    assert (result.status, result.err) == (0, "")
    assert (place(odd) / "true" / "tables.md").exists()
    if "," not in odd:  # else a list has to be quoted for Hydra by hand
        result = call("report", f"runs=[{odd}/runs]", f"output={odd}/1", "pictures=false")
        assert (result.status, result.err) == (0, "")


# --- a place that cannot be written to is told before the work ----------------------------------


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object, **others: object) -> None:
        raise AssertionError("the work has begun")

    for name in (
        *(
            "reconstruct.open_input",
            "evaluate.evaluate",
            "report.open_study",
            "pretrain.open_source",
        ),
        *("benchmark.run_all", "prepare.open_source", "train.train"),
    ):
        monkeypatch.setattr(f"tf_lab.commands.{name}", fail)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    ("command", "word"),
    [
        (("reconstruct",), "output=file/mesh.ply"),
        (("reconstruct", "input=capture"), "output=folder.ply"),
        (("evaluate", "predictions=a", "groundtruth=b"), "output=file/deep/m.json"),
        (("evaluate", "predictions=a", "groundtruth=b"), "output=folder.ply"),
        (("report",), "output=file"),
        (("report",), "output=file/report"),
        (("report",), f"output={300 * 'x'}"),  # longer than a name may be
        (("pretrain", "model=tiny"), "output=file/encoder.safetensors"),
        (("benchmark", "model=tiny"), "output=file"),
        (("prepare",), "shards=file/shards"),
        (("train", *TINY), "output=file"),
        (("train", "-m", *TINY), "output=file"),
    ],
)
def test_no_place_for_the_result(command: tuple[str, ...], word: str, tmp_path: Path) -> None:
    Path("file").write_text("")
    Path("folder.ply").mkdir()
    told(call(*command, word), word.partition("=")[2])
    assert {path.name for path in tmp_path.iterdir()} == {"file", "folder.ply"}


# --- one input never overwrites what another made ------------------------------------------------


def test_inputs_of_one_name_have_meshes_of_their_own(
    posed_images: Path, checkpoint: Path, tmp_path: Path
) -> None:
    made = {}
    outside = [str(tmp_path / "outside" / scene / "seq-01") for scene in ("chess", "fire")]
    for source in ("here/chess/seq-01", "here/fire/seq-01", *outside):
        shutil.copytree(posed_images, tmp_path / source)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(tmp_path / "here")
            result = call(
                *("reconstruct", f"input={source.removeprefix('here/')}"),
                *(f"checkpoint={checkpoint}", "resolution=0.05", "threshold=0", "device=cpu"),
            )
        assert result.status == 0, result.err
        made = {p: p.stat().st_mtime_ns for p in (tmp_path / "here/outputs").rglob("*.ply")}
    places = {str(path.relative_to(tmp_path / "here/outputs/reconstructions")) for path in made}
    hashes = [hashlib.sha256(source.encode()).hexdigest()[:8] for source in outside]
    assert places == {
        *("chess/seq-01.ply", "fire/seq-01.ply"),
        *(f"seq-01_{known}.ply" for known in hashes),
    }


@pytest.mark.parametrize(
    ("command", "words", "goes_on"),
    [
        ("reconstruct", (), False),
        ("evaluate", ("predictions=a", "groundtruth=b"), False),
        ("report", (), False),
        ("train", (), True),
        ("prepare", (), True),
        ("pretrain", (), True),
    ],
)
def test_going_on_is_said_by_commands_that_do(
    command: str, words: tuple[str, ...], goes_on: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tf_lab.cli.run.typed", interrupt)
    result = call(command, *words)
    assert result.status == 130
    (line,) = result.err.splitlines()
    assert line.startswith("interrupted: ")
    assert ("is kept" in line or "are kept" in line) == goes_on
    assert ("starts again" in line) != goes_on


def test_the_end_of_the_viewer_says_nothing_of_what_it_wrote(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupt(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tf_lab.cli.run.typed", interrupt)
    result = call("view")
    line = "interrupted: the page is gone, the same command shows it again\n"
    assert (result.status, result.err) == (130, line)
