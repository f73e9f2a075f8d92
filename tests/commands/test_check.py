"""`python -m tf_lab.check`: what a capture is told to be, on screen, as JSON and as a picture."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.injections import INJECTIONS
from helpers.layouts import plain, room_frames
from helpers.tiny_jobs import call
from tf_lab.commands.check import lines
from tf_lab.data.diagnosis.sensors import Sensors
from tf_lab.data.diagnosis.verdict import FINE, Report
from tf_lab.data.import_capture import ImportSettings, import_capture
from tf_lab.data.prepare_captures import PreparedCaptures, summarise
from tf_lab.data.reading import ReadSettings

DOWN = "gravity=[0,0,-1]"


def written(fault: str | None, folder: Path) -> Path:
    """A room in the plain layout, with a fault."""
    frames = list(room_frames())
    return plain.write(folder, frames if fault is None else INJECTIONS[fault].do(frames))


@pytest.fixture
def inverted(tmp_path: Path) -> Path:
    return written("inverted", tmp_path / "kitchen")


def test_a_right_capture(tmp_path: Path) -> None:
    written(None, tmp_path / "kitchen")
    result = call("check", "input=kitchen", DOWN)
    assert (result.status, result.err) == (0, "")
    assert result.out.splitlines()[-1] == "kitchen: fine"
    for figure in (
        f"{len(room_frames())}, of them keyframes",
        "96x72",
        "from: gravity=",
        "as given",
    ):
        assert figure in result.out
    assert [path.name for path in tmp_path.iterdir()] == ["kitchen"]


def test_what_is_fine_is_told_no_better_setting(tmp_path: Path) -> None:
    """By chance some focal length and some principal point always have the smaller error."""
    written(None, tmp_path / "kitchen")
    result = call("check", "input=kitchen", DOWN, "output=found")
    found = json.loads((tmp_path / "found" / "check.json").read_text())["alternatives"]
    errors = {entry["setting"]: entry["error_pixels"] for entry in found}
    by_chance = [setting for setting, error in errors.items() if error < errors[""]]
    assert by_chance
    assert not [setting for setting in by_chance if setting in result.out]
    assert "shift=1" in result.out
    assert "no other way to read the capture has clearly smaller errors" in result.out


def test_a_wrong_capture_and_its_mend(inverted: Path, tmp_path: Path) -> None:
    result = call("check", "input=kitchen", DOWN, "output=found")
    assert (result.status, result.err) == (1, "")
    assert "kitchen: wrong; to mend it: poses=world_to_camera" in result.out.splitlines()
    report = json.loads((tmp_path / "found" / "check.json").read_text())
    assert (report["verdict"], report["settings"]) == ("wrong", ["poses=world_to_camera"])
    errors = {entry["setting"]: entry["error_pixels"] for entry in report["alternatives"]}
    assert errors["poses=world_to_camera"] < 0.3 < 2 < errors[""]
    assert report["statistics"]["frames"] == len(room_frames())
    with Image.open(tmp_path / "found" / "check.png") as picture:
        assert min(picture.size) > 500
        assert np.asarray(picture.convert("L")).std() > 20
    mended = call("check", "input=kitchen", DOWN, "poses=world_to_camera")
    assert (mended.status, mended.out.splitlines()[-1]) == (0, "kitchen: fine")


def test_intrinsics_of_larger_images(tmp_path: Path) -> None:
    """What reconstruct refuses is told here with its cure."""
    K = room_frames()[0].K
    larger = np.array([[2.0, 0, 0.6], [0, 2, 0.6], [0, 0, 1]]) @ K
    plain.write(tmp_path / "kitchen", [replace(f, K=larger) for f in room_frames()])
    result = call("check", "input=kitchen", DOWN)
    assert result.status == 1
    assert result.out.splitlines()[-1].endswith("wrong; to mend it: 'intrinsics_size=[192,144]'")


def test_images_that_cannot_be_read_are_counted_and_named(tmp_path: Path) -> None:
    folder = written(None, tmp_path / "kitchen") / "images"
    images = sorted(folder.iterdir(), key=lambda path: int(path.stem))
    cut, empty = images[3], images[-1]
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    empty.write_bytes(b"")
    result = call("check", "input=kitchen", DOWN, "output=found")
    assert (result.status, result.err) == (1, "")
    (figure,) = (line for line in result.out.splitlines() if "unreadable" in line)
    assert f"2 of {len(images)} images" in figure
    (line,) = (line for line in result.out.splitlines() if "cannot be read" in line)
    assert f"2 of {len(images)} images cannot be read" in line
    assert f"({cut.stem}, {empty.stem})" in line
    told = json.loads((tmp_path / "found" / "check.json").read_text())["statistics"]["unread"]
    assert [reason.partition(": ")[0] for reason in told] == [cut.stem, empty.stem]


@pytest.mark.parametrize(
    ("best", "told"),
    [
        (0.909, "correlation 0.914; no other focal length or offset is better"),
        (0.95, "best 0.950 with 0.997 times the focal length and colour (10, 0) mm off"),
    ],
)
def test_no_worse_fit_of_the_sensors_is_called_the_best(best: float, told: str) -> None:
    sensors = Sensors(9, 0.914, 0.997, (0.01, 0.0), best, False, float("nan"), float("nan"))
    report = Report(FINE, [], [], 9, 99, 0.1, sensors=sensors)
    (line,) = (line for line in lines(report, Path("room")) if line.startswith("colour against"))
    assert line.endswith(told)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "usage: python -m tf_lab.check input=DIR"),
        (("input=nowhere",), "nowhere: no such folder"),
        (("input=kitchen", "axes=blender"), "axes=blender: choose opencv"),
        (("input=kitchen", "output=kitchen/K.txt"), "is a file; give a folder"),
    ],
)
def test_errors_are_a_line(inverted: Path, words: tuple[str, ...], told: str) -> None:
    result = call("check", *words)
    assert (result.status, len(result.err.splitlines())) == (2, 1)
    assert told in result.err


def test_prepare_warns(tmp_path: Path) -> None:
    wrong = written("focal x 0.8", tmp_path / "kitchen")
    settings = ImportSettings(48, 36, 0.5, ReadSettings(gravity=(0.0, 0.0, -1.0)))
    for name, check in (("checked", True), ("unchecked", False)):
        import_capture(tmp_path / name, wrong, settings, memory=2**28, check=check)
    scenes = {name: tmp_path / name for name in ("checked", "unchecked")}
    text = summarise(PreparedCaptures(scenes, {}), tmp_path)
    (line,) = (line for line in text.splitlines() if "warning" in line)
    assert "warning checked: focal length" in line
    assert "try focal_scale=1.2" in line
