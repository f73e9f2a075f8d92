"""A result is of the data that it was asked of: other data is never taken for it, equal data is."""

import json
import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers import small_shards
from helpers.layouts import plain as plain_layout, room_frames, scannet
from helpers.tiny_jobs import TINY, Result, call, told
from tf_lab.commands.train import identified
from tf_lab.config.compose import compose_config
from tf_lab.config.schema import TrainConfig
from tf_lab.data import digests
from tf_lab.data.chunk_sampler import ChunkSampler
from tf_lab.data.scene import Scene
from tf_lab.data.sources.source import open_source
from tf_lab.errors import TFLabError
from tf_lab.experiments.identity import run_directory, training_directory
from tf_lab.reporting.results import read_run
from tf_lab.support.headers import read_info

TESTED = ("data.root", "data.test", "optimizer.steps")
OF_ROOMS = ("data.size", "data.val_size", "data.test_size", "data.frames", "data.test_frames")
SETTINGS = (
    *(word for word in TINY if word.partition("=")[0] not in OF_ROOMS),
    *("data.keyframe_distance=0", "training.images=2", "training.coverage=0.1"),
)


def write(capture: Path, first: int, last: int) -> Path:
    """A capture of some frames of a room."""
    plain_layout.write(capture, room_frames()[first:last])
    (capture / "gravity-direction.txt").write_text("0 0 -1")
    return capture


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Two captures, one to train on and one to test on."""
    write(tmp_path / "a" / "kitchen", 0, 8)
    write(tmp_path / "a" / "office", 12, 20)
    return tmp_path / "a"


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes are made here: a process each costs seconds."""

    def run(tasks: Mapping[str, Callable[[], None]], title: str, workers: int) -> dict[str, str]:
        failed = {}
        for name, task in tasks.items():
            try:
                task()
            except TFLabError as error:
                failed[name] = str(error)
        return failed

    monkeypatch.setattr("tf_lab.data.prepare_captures.run_tasks", run)


def arguments(root: Path) -> tuple[str, ...]:
    return ("data=captures", *SETTINGS, f"data.root={root}", "data.test=[office]")


def training_scenes(config: TrainConfig) -> list[Path]:
    source = open_source(config.data, config.content)
    return [*source.scenes("train")["train"].values()]


def configured(*words: str) -> TrainConfig:
    return identified(compose_config("train", *words))


def of_root(root: Path, *more: str) -> TrainConfig:
    return configured(*arguments(root), *more)


def keys(config: TrainConfig) -> tuple[Path, Path]:
    """The directories of the training and of the evaluation."""
    return training_directory(config), run_directory(config)


def directories(root: Path, *more: str) -> tuple[Path, Path]:
    return keys(of_root(root, *more))


def swap_poses(capture: Path) -> None:
    """Another pose for every image."""
    poses = capture / "poses.txt"
    poses.write_text("".join(reversed(poses.read_text().splitlines(keepends=True))))


def test_another_root_with_captures_of_the_same_names(root: Path, tmp_path: Path) -> None:
    write(tmp_path / "b" / "kitchen", 12, 20)
    write(tmp_path / "b" / "office", 0, 8)
    assert not {*directories(root)} & {*directories(tmp_path / "b")}


def test_the_same_captures_elsewhere(root: Path, tmp_path: Path) -> None:
    first = directories(root)
    copy = shutil.copytree(root, tmp_path / "copy", ignore=shutil.ignore_patterns("tf_lab"))
    for path in copy.rglob("*.*"):
        os.utime(path)
    assert directories(copy) == first
    assert directories(copy, "data.train=[kitchen]") == first  # named instead of left over


def test_scores_by_given_ground_truth(root: Path, tmp_path: Path) -> None:
    """Another evaluation of the same training; known by content, and there for every test scene."""
    own = directories(root)
    (scene,) = open_source(of_root(root).data).scenes("test")["test"].values()
    files = shutil.ignore_patterns("sdf.npy", "distance.npy", "chunks.npz")
    shutil.copytree(scene / "groundtruth", tmp_path / "given" / "office", ignore=files)
    given = tmp_path / "given"
    first = directories(root, f"groundtruth={given}")
    assert (first[0], first[1] == own[1]) == (own[0], False)
    copy = shutil.copytree(given, tmp_path / "copy")
    assert directories(root, f"groundtruth={copy}") == first
    shutil.copytree(given / "office", copy / "hall")  # of a scene that is not tested
    assert directories(root, f"groundtruth={copy}") == first
    np.savetxt(copy / "office" / "world2grid.txt", np.eye(4))
    assert directories(root, f"groundtruth={copy}")[1] not in (own[1], first[1])
    (copy / "office" / "mesh_gt.ply").unlink()
    with pytest.raises(TFLabError, match="lacks that of 1 of 1 scene, the first: office; a scene"):
        directories(root, f"groundtruth={copy}")
    with pytest.raises(TFLabError, match="nowhere: no such folder"):
        directories(root, "groundtruth=nowhere")


def test_a_capture_more(root: Path) -> None:
    training, run = directories(root)
    write(root / "hall", 8, 12)
    assert directories(root)[0] != training
    assert directories(root, "data.train=[kitchen]") == (training, run)
    held_out = directories(root, "data.val=[hall]")
    assert held_out == (training, run)  # a val scene shapes nothing


def test_corrected_poses(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    training, _ = directories(root)
    before = Scene(training_scenes(of_root(root))[0])
    swap_poses(root / "kitchen")
    assert directories(root)[0] != training
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("kitchen: made anew (poses.txt changed)")
    after = Scene(training_scenes(of_root(root))[0])
    np.testing.assert_allclose(after.world_T_cam, before.world_T_cam[::-1], atol=1e-12)
    assert after.provenance["sources"] == after.directory.name
    swap_poses(root / "kitchen")  # and back: the old scene is still there
    assert directories(root)[0] == training


def test_a_changed_picture_of_the_test_scene(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    training, run = directories(root)
    picture = root / "office" / "images" / "3.png"
    with Image.open(picture) as image:
        turned = image.transpose(Image.Transpose.ROTATE_180)
    turned.save(picture)
    assert directories(root)[0] == training
    assert directories(root)[1] != run
    assert "office: made anew (images/3.png changed)" in capsys.readouterr().out


def test_unchanged_captures_are_not_read(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = directories(root)
    monkeypatch.setattr(digests, "_hash", lambda path: pytest.fail(f"{path} is read"))
    assert directories(root) == first


def test_touched_captures_are_not_made_again(
    root: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = directories(root)
    monkeypatch.setattr(
        "tf_lab.data.prepare_captures.import_capture", lambda *_, **__: pytest.fail("made again")
    )
    for path in root.glob("*/*.txt"):
        os.utime(path)
    assert directories(root) == first
    monkeypatch.setattr(digests, "_hash", lambda path: pytest.fail(f"{path} is read twice"))
    assert directories(root) == first
    assert capsys.readouterr().out == ""


def test_a_run_keeps_to_its_scenes(root: Path) -> None:
    """Whatever happens to the captures while it works."""
    config = of_root(root)
    (directory,) = training_scenes(config)
    swap_poses(root / "kitchen")
    (other,) = training_scenes(of_root(root))
    assert other != directory
    assert training_scenes(config) == [directory]
    assert len(Scene(directory)) == 8


def test_scenes_whose_captures_are_gone(root: Path, tmp_path: Path) -> None:
    """As where only the prepared scenes were copied to."""
    first = directories(root)
    prepared = (root / "tf_lab").rename(tmp_path / "scenes")
    shutil.rmtree(root)
    with pytest.raises(TFLabError, match="no such folder"):
        directories(root)
    assert directories(root, f"data.scenes={prepared}") == first
    (tmp_path / "copy").mkdir()
    prepared.rename(tmp_path / "copy" / "tf_lab")
    assert directories(tmp_path / "copy") == first


def test_scannet_scenes_whose_streams_are_gone(tmp_path: Path) -> None:
    for split, number in (("train", 0), ("val", 1), ("test", 2)):
        name = f"scene000{number}_00"
        scannet.write(tmp_path / "scans" / name, room_frames()[6 * number : 6 * number + 6])
        (tmp_path / f"scannetv2_{split}.txt").write_text(name)
    first = keys(configured("data=scannet", *SETTINGS, f"data.root={tmp_path}"))
    (tmp_path / "scans" / "scene0000_00" / "scene0000_00.txt").write_text("added")
    second = keys(configured("data=scannet", *SETTINGS, f"data.root={tmp_path}"))
    assert (second[0] != first[0], second[1] != first[1]) == (True, True)
    shutil.rmtree(tmp_path / "scans" / "scene0000_00" / "color")
    shutil.rmtree(tmp_path / "scans" / "scene0002_00")
    assert keys(configured("data=scannet", *SETTINGS, f"data.root={tmp_path}")) == second


def test_what_cannot_be_made_anew_is_not_used_as_it_was(root: Path) -> None:
    directories(root)
    (root / "kitchen" / "poses.txt").write_text("1 2 3")
    with pytest.raises(TFLabError, match="none of the train scenes can be prepared"):
        of_root(root)


def test_a_test_on_other_data(root: Path, tmp_path: Path) -> None:
    """It scores as a training of no steps of the same weights does on that data."""
    write(tmp_path / "b" / "hall", 4, 12)
    output = f"output={tmp_path / 'outputs'}"
    elsewhere = (f"test_on.root={tmp_path / 'b'}", "test_on.test=[hall]")
    distance = "test_on.keyframe_distance=0"
    first = call("train", *arguments(root), "test_on=captures", *elsewhere, distance, output)
    assert first.status == 0, first.err
    training, run = first.path("training"), first.path("run")
    origin = json.loads((run / "run.json").read_text())
    assert [*origin["scenes"]] == ["hall"]
    assert [*origin["training"]["scenes"]] == ["kitchen"]

    there = (f"data.root={tmp_path / 'b'}", "data.test=[hall]", "optimizer.steps=0")
    words = [word for word in arguments(root) if word.partition("=")[0] not in TESTED]
    by_init = call("train", *words, *there, f"init={training}", output)
    assert by_init.status == 0, by_init.err
    metrics = [json.loads((r.path("run") / "metrics.json").read_text()) for r in (first, by_init)]
    assert metrics[0]["scenes"] == metrics[1]["scenes"]
    assert "warning" not in by_init.err
    taken = read_info(by_init.path("training") / "model.safetensors")["training"]
    assert taken["init"]["scenes"] == origin["training"]["scenes"]
    assert taken["init"]["command"] == origin["training"]["command"]
    tested, trained = (read_run(r.path("run")).settings for r in (by_init, first))
    steps = "optimizer.steps"  # which network is tested, the report says as the training would
    assert (tested[steps], tested[f"init.{steps}"]) == (0, trained[steps])

    own = call("train", *arguments(root), output)  # the same training on its own test scene
    assert "reusing the identical finished training" in own.out
    assert own.path("run") != run
    assert call("runs", "show", run.name, output).status == 0
    swap_poses(tmp_path / "b" / "hall")
    again = call("train", *arguments(root), "test_on=captures", *elsewhere, distance, output)
    assert again.path("run") != run


def test_weights_that_were_trained_on_a_test_scene_are_told(root: Path, tmp_path: Path) -> None:
    output = f"output={tmp_path / 'outputs'}"
    training = call("train", *arguments(root), output).path("training")
    words = [word for word in arguments(root) if word.partition("=")[0] not in TESTED]
    of_kitchen = ("optimizer.steps=0", f"data.root={root}", "data.test=[kitchen]")
    larger = ("data.width=96", "data.height=72")
    result = call("train", *words, *of_kitchen, *larger, f"init={training}", output)
    first, second = result.err.splitlines()
    assert f"init={training}: was trained on images of 80x60, these are of 96x72" in first
    assert "data.width=80 data.height=60 makes them alike" in first
    assert second.startswith(f"warning: kitchen is tested on, and init={training} was trained on")


def test_images_to_test_on_of_another_size_are_told(root: Path, tmp_path: Path) -> None:
    write(tmp_path / "b" / "hall", 4, 12)
    words = ("test_on=captures", f"test_on.root={tmp_path / 'b'}", "test_on.test=[hall]")
    sizes = ("test_on.width=40", "test_on.height=30")
    output = f"output={tmp_path / 'outputs'}"
    result = call("train", *arguments(root), *words, *sizes, output)
    assert result.status == 0
    assert "the network is trained on images of 80x60, these are of 40x30" in result.err
    assert "test_on.width=80 test_on.height=60 makes them alike" in result.err


def test_what_is_wrong_with_the_data_to_test_on_is_told_first(root: Path, tmp_path: Path) -> None:
    """Before the scenes to train on are made."""
    for wrong in (f"test_on.root={tmp_path / 'nowhere'}", f"test_on.root={root}"):
        result = call("train", *arguments(root), "test_on=captures", wrong, "test_on.test=[x]")
        assert (result.status, result.out) == (2, "")
        assert "test_on." in result.err
    result = call("train", *arguments(root), "test_on=captures", f"test_on.root={root}")
    told(result, "there is no test scene (test_on.test, test_on.test_size): give one")
    assert not (root / "tf_lab").exists()


def test_what_is_trained_on_is_not_tested_on(root: Path, tmp_path: Path) -> None:
    shutil.copytree(root / "kitchen", tmp_path / "b" / "other")
    words = ("test_on=captures", f"test_on.root={tmp_path / 'b'}", "test_on.test=[other]")
    with pytest.raises(TFLabError, match=r"test_on: other is trained on, too \(kitchen of data="):
        of_root(root, *words)
    with pytest.raises(TFLabError, match=r"test_on\.test: there is no|test_on\.test.*hall"):
        of_root(root, *words[:2], "test_on.test=[hall]")
    with pytest.raises(TFLabError, match=r"test_on\.root=.*nowhere: no such folder"):
        of_root(root, "test_on=captures", f"test_on.root={tmp_path / 'nowhere'}")


def test_trained_from_shards_beside_captures_that_are_tested_on(
    root: Path, rooms: Callable[[str], list[Path]], tmp_path: Path
) -> None:
    config = compose_config("train", *arguments(root))
    drawn = ChunkSampler(rooms("train"), config.training.chunk, config.model.near, config.model.far)
    small_shards.write(tmp_path / "shards", drawn, count=3, per_shard=3)
    urls = (f"data.urls={tmp_path / 'shards'}", f"output={tmp_path / 'out'}")
    result = call("train", *arguments(root), *urls)
    assert (result.status, result.err) == (0, "")
    assert "office" in result.out


def test_the_train_command_on_two_roots(root: Path, tmp_path: Path) -> None:
    write(tmp_path / "b" / "kitchen", 8, 16)
    write(tmp_path / "b" / "office", 0, 8)

    def train(root: Path) -> Result:
        result = call("train", *arguments(root), f"output={tmp_path / 'outputs'}")
        assert result.status == 0, result.err
        return result

    first, second, again = train(root), train(tmp_path / "b"), train(root)
    assert "reusing" not in second.out
    assert "reusing the identical finished evaluation" in again.out
    assert again.path("run") == first.path("run") != second.path("run")
    made = Scene(next((root / "tf_lab").glob("*/office/*/scene.json")).parent)
    origin = json.loads((first.path("run") / "run.json").read_text())
    assert origin["scenes"] == {"office": made.provenance["sources"]}
    info = read_info(first.path("training") / "model.safetensors")["training"]
    assert list(info["scenes"]) == ["kitchen"]
    assert str(root) not in json.dumps(info["config"])
    name = first.path("training").name
    shown = call("runs", "show", name, f"output={tmp_path / 'outputs'}").out
    assert info["scenes"]["kitchen"] in shown
    provenance = shown.partition("provenance:")[2].partition("\nconfig:")[0]
    assert provenance and '"config"' not in provenance  # nor that of the weights it began with
