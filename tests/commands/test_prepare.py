"""prepare: killed at any moment, or started twice, it ends with the same files."""

import hashlib
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.layouts import room_frames, seven_scenes
from helpers.tiny_jobs import TINY, call, environment, start, tiny_config
from tf_lab.data.scene import Scene
from tf_lab.data.sources.source import open_source

SETTINGS = ("data=captures", "data.width=48", "data.height=36", "data.keyframe_distance=0")


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    """Three captures: one of them is damaged, one has a broken frame."""
    root = tmp_path / "captures"
    for name in ("hall", "kitchen", "office"):
        seven_scenes.write(root / name, room_frames())
    (root / "hall" / "camera-intrinsics.txt").write_text("not numbers")
    (root / "office" / "frame-000004.color.png").write_bytes(b"")
    return root


def arguments(captures: Path, scenes: Path) -> list[str]:
    return [*SETTINGS, f"data.root={captures}", f"data.scenes={scenes}", "data.gravity=[0,0,-1]"]


def digest(directory: Path) -> dict[str, str]:
    """Of every file, also hidden ones."""
    files = sorted(path for path in directory.rglob("*") if path.is_file())
    return {
        str(p.relative_to(directory)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files
    }


def test_the_summary_tells_what_was_skipped_and_what_failed(captures: Path, tmp_path: Path) -> None:
    result = call("prepare", *arguments(captures, tmp_path / "scenes"))
    assert result.status == 2
    assert "2 scenes, 47 frames" in result.out
    assert "skipped 1 frame: cannot be read as an image" in result.out
    assert "failed hall: " in result.out
    assert "camera-intrinsics.txt" in result.out
    assert result.err.splitlines()[-1].startswith("error: 1 scene failed")
    (settings,) = (tmp_path / "scenes").iterdir()
    left = {p.name for p in settings.iterdir()} - {".lock"}
    assert left == {"kitchen", "office", "prepare.json"}


@pytest.mark.long
def test_killed_and_restarted_it_ends_with_equal_bytes(captures: Path, tmp_path: Path) -> None:
    call("prepare", *arguments(captures, tmp_path / "expected"))
    command = [sys.executable, "-m", "tf_lab.prepare", *arguments(captures, tmp_path / "killed")]
    process = subprocess.Popen(command, env=environment(), stdout=-3, stderr=-3)
    deadline = time.time() + 120
    while not list(
        (tmp_path / "killed").glob("*/*/.partial-*/color/*")
    ):  # in the middle of a scene
        assert process.poll() is None
        assert time.time() < deadline
        time.sleep(0.01)
    process.kill()
    process.wait()
    time.sleep(1)  # its workers notice
    again = call("prepare", *arguments(captures, tmp_path / "killed"))
    assert "2 scenes" in again.out, again.err
    assert digest(tmp_path / "killed") == digest(tmp_path / "expected")


@pytest.mark.long
def test_two_at_once_do_no_harm(captures: Path, tmp_path: Path) -> None:
    call("prepare", *arguments(captures, tmp_path / "expected"))
    command = [sys.executable, "-m", "tf_lab.prepare", *arguments(captures, tmp_path / "both")]
    first = subprocess.Popen(command, env=environment(), stdout=-3, stderr=-3)
    second = start("prepare", *arguments(captures, tmp_path / "both"), cwd=tmp_path)
    assert (first.wait(), second.status) == (2, 2)  # because of the damaged capture
    assert digest(tmp_path / "both") == digest(tmp_path / "expected")


def test_training_and_testing_on_captures(captures: Path, tmp_path: Path) -> None:
    """The prepared scenes are trained on and evaluated like rooms; the broken one is left out."""
    result = call(
        "train",
        *arguments(captures, tmp_path / "scenes"),
        *("data.val=[office]", "data.test=[office]", f"output={tmp_path / 'outputs'}"),
        *("model.width=8", "model.hidden=16", "model.refine_blocks=1", "model.far=2.5"),
        *("encoder.weights=none", "encoder.width=8", "encoder.blocks=[1,1,1]"),
        *("encoder.coarse_channels=8", "encoder.fine_channels=8", "training.chunks=1"),
        *("training.images=2", "training.views=[2]", "training.coverage=0.2"),
        *("training.validate_every=2", "optimizer.steps=2", "resolution=0.05"),
        *("trainer.accelerator=cpu", "trainer.workers=0"),
    )
    assert result.status == 0, result.err
    assert "office" in result.out
    assert "no score" not in result.out
    (log,) = (tmp_path / "outputs").glob("trainings/*/logs/version_0/metrics.csv")
    assert "val/fscore" in log.read_text()
    assert "scene hall is left out" in result.out + result.err


def test_pictures_of_rooms(cache: Path) -> None:
    arguments = [word for word in TINY if word.startswith("data.")]
    result = call("prepare", *arguments, "pictures=true", "splits=[val,test]")
    assert (result.status, result.err) == (0, "")
    for name in ("room_1000000", "room_2000000"):
        (picture,) = cache.glob(f"rooms-*/pictures/{name}.png")
        with Image.open(picture) as image:
            assert np.asarray(image.convert("L")).std() > 10


def test_flats_are_a_data_group_like_rooms(cache: Path) -> None:
    """Prepared, with how many views their points have, and found again by the name of a scene."""
    arguments = [
        "data=flats",
        *(word for word in TINY if word.startswith("data.")),
        "data.frames=4",
    ]
    arguments.append("data.test_frames=12")
    result = call("prepare", *arguments, "splits=[test]")
    assert (result.status, result.err) == (0, "")
    (flat,) = cache.glob("flats-*/test/flat_2000000")
    assert f"test: 1 flats in {flat.parent}" in result.out
    frames = len(Scene(flat))
    assert frames % 12 == 0
    assert f"flat_2000000: {frames} frames, median point seen by" in result.out
    config = tiny_config(*arguments, f"data.root={cache}")
    assert open_source(config.data).directory("flat_2000000", None) == flat
    assert set(config.content.versions) == {"groundtruth", "flats"}


def test_a_test_scene_that_is_not_there_is_told_before_the_training(captures: Path) -> None:
    result = call("train", "data=captures", f"data.root={captures}", "data.test=[attic]")
    assert result.status == 2
    assert "data.test: attic: not there; there are: " in result.err
    assert not Path("outputs").exists()


@pytest.mark.long
def test_shards_are_written_and_trained_on(captures: Path, tmp_path: Path) -> None:
    drawing = ("training.images=2", "training.views=[2]", "training.coverage=0.2", "model.far=2.5")
    common = [*arguments(captures, tmp_path / "scenes"), "data.test=[office]", *drawing]
    shards = tmp_path / "shards"
    written = call("prepare", *common, f"shards={shards}", "shard_chunks=5", "shard_size=2")
    assert f"{shards}: 5 chunks" in written.out
    assert len(list(shards.glob("chunks-*.tar"))) == 3
    result = call(
        *("train", *common, f"data.urls={shards}", f"output={tmp_path / 'outputs'}"),
        *("model.width=8", "model.hidden=16", "model.refine_blocks=1", "training.chunks=1"),
        *("encoder.weights=none", "encoder.width=8", "encoder.blocks=[1,1,1]"),
        *("encoder.coarse_channels=8", "encoder.fine_channels=8", "training.validate_every=0"),
        *("optimizer.steps=2", "resolution=0.05", "trainer.accelerator=cpu", "trainer.workers=0"),
    )
    assert result.status == 0, result.err
    assert "office" in result.out


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["data=captures"], "data.root"),
        (["data=captures", "data.root=nowhere"], "data.root=nowhere: no such folder"),
        (["data=scannet", "data.root=nowhere"], "nowhere"),
        (["data=martian"], "martian"),
    ],
)
def test_bad_sources(overrides: list[str], expected: str) -> None:
    result = call("prepare", *overrides)
    assert result.status != 0
    assert expected in result.err
    assert "Traceback" not in result.err
