"""Files made to do harm, each by a trick of its own: told in one line, and nothing happens."""

import io
import json
import os
import pickle
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from helpers import box_room, made_up_runs
from helpers.fuzz.archives import HARMLESS, KINDS, change_tar
from helpers.fuzz.kinds import network, read_a_shard, write_a_scene, write_a_shard
from helpers.fuzz.mutations import BOMB, DEEP, MERGE, resize_png
from tf_lab.commands.runs import details, listing
from tf_lab.data.capture import read_depth, read_image
from tf_lab.data.lens import Camera
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.experiments.inventory import find_runs as find_entries
from tf_lab.network.encoders.weights import read_state_dict
from tf_lab.online import Reconstructor
from tf_lab.reporting.gallery import draw_pictures
from tf_lab.reporting.results import find_runs
from tf_lab.reporting.studies import open_study
from tf_lab.support.arrays import read_array, read_arrays

OUTSIDE = "../../../../outside"


# --- runs ----------------------------------------------------------------------------------------


def text(name: str, content: str) -> Callable[[Path], None]:
    return lambda run: (run / name).write_text(content) and None


def edit(file: str, /, **values: Any) -> Callable[[Path], None]:
    def change(run: Path) -> None:
        found = json.loads((run / file).read_text())
        (run / file).write_text(json.dumps({**found, **values}))

    return change


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (text("metrics.json", DEEP), "metrics.json: damaged: not JSON"),
        (text("config.yaml", BOMB), "config.yaml: damaged: holds more than"),
        (text("config.yaml", MERGE), "config.yaml: damaged"),
        (text("config.yaml", "a: &a [*a]"), "config.yaml: damaged: nested more than"),
        (text("config.yaml", "- a"), "config.yaml: .*not a mapping"),
        (edit("metrics.json", mean={"acc": 10**400}), "metrics.json: .*digits"),
        (edit("metrics.json", mean=[1]), "metrics.json: mean is list, not a mapping"),
        (edit("metrics.json", scenes={}), "metrics.json: there is no scene"),
        (edit("run.json", training=["a"]), "run.json: training is list, not a mapping"),
        (edit("run.json", checkpoint=3), "run.json: checkpoint is 3, not text"),
    ],
)
def test_one_damaged_run_is_told_and_the_others_stay(
    tmp_path: Path, damage: Callable[[Path], None], expected: str
) -> None:
    good = made_up_runs.write_run(tmp_path, "", 0, [0.5])
    bad = made_up_runs.write_run(tmp_path, "", 1, [0.6])
    damage(bad)
    runs, damaged = find_runs([tmp_path / "runs"])
    assert [run.directory for run in runs] == [good]
    (line,) = damaged
    assert "\n" not in line
    assert re.search(expected, line), line
    listed = listing(tmp_path)
    assert good.name in listed
    assert re.search(expected, listed.partition("cannot be read:")[2]), listed
    for entry in find_entries(tmp_path):
        assert bool(re.search(expected, details(entry))) == (entry.directory == bad)


def test_a_scene_named_as_a_path_is_drawn_in_its_folder(tmp_path: Path) -> None:
    output = tmp_path / "a" / "b" / "c" / "outputs"
    run = made_up_runs.write_run(output, "", 0, {OUTSIDE: 0.5})
    (run / "meshes").mkdir()
    study, _ = open_study([output / "runs"])
    trimesh.creation.box().export(run / "meshes" / "x.ply")
    assert draw_pictures(study, output / "report", (40, 30)) == 0  # no mesh under that name
    for path in (run / "meshes").iterdir():
        shutil.copy(path, tmp_path / "a" / "outside.ply")
    assert draw_pictures(study, output / "report", (40, 30)) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a"]


# --- scenes and captures -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def a_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hostile")
    write_a_scene(folder)
    return folder / "scene"


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"size": "80x60"}, "scene.json: size is '80x60', not a list of 2"),
        ({"skipped": None}, "scene.json: skipped is None, not a list"),
        ({"name": 7}, "scene.json: name is 7, not text"),
        ({"K": lambda K: K[1:]}, "cameras.npz: damaged"),
        ({"world_T_cam": lambda poses: poses[:, :3]}, "cameras.npz: damaged"),
        ({"K": lambda K: K * [[1e-6], [1e-6], [1]]}, "too short for images of 80x60"),
        ({"frames": lambda names: names.astype(object)}, "cameras.npz: damaged"),
    ],
)
def test_a_scene_with_something_else_in_it(
    a_scene: Path, tmp_path: Path, change: dict[str, Any], expected: str
) -> None:
    scene = Path(shutil.copytree(a_scene, tmp_path / "scene"))
    for name, value in change.items():
        if callable(value):
            with np.load(scene / "cameras.npz") as file:
                arrays = dict(file)
            np.savez(scene / "cameras.npz", **{**arrays, name: value(arrays[name])})
        else:
            edit("scene.json", **{name: value})(scene)
    with pytest.raises(TFLabError, match=expected):
        Scene(scene)


def test_frames_named_as_paths_are_looked_for_in_the_scene(a_scene: Path, tmp_path: Path) -> None:
    scene = Path(shutil.copytree(a_scene, tmp_path / "a" / "scene"))
    shutil.copy(next((scene / "color").iterdir()), tmp_path / "secret.jpg")
    with np.load(scene / "cameras.npz") as file:
        arrays = dict(file)
    arrays["frames"] = np.array(["../../../secret"] * len(arrays["frames"]))
    np.savez(scene / "cameras.npz", **arrays)
    with pytest.raises(TFLabError, match="cannot be read"):
        Scene(scene).jpeg(0)
    assert Scene(scene).depth(0) is None


def test_intrinsics_in_other_units_are_told_as_such() -> None:
    with pytest.raises(TFLabError, match="in units of the image: multiply fx, cx by its width"):
        Camera((640, 480), 0.8, 1.1, 0.5, 0.5)
    with pytest.raises(TFLabError, match="too short for images of 640x480 pixels"):
        Camera((640, 480), 1e-6, 1e-6, 320, 240)
    Camera((640, 480), 200, 200, 320, 240)  # 116 degrees
    frame = next(iter(box_room.frames()))
    with pytest.raises(TFLabError, match="units of the image"):
        Reconstructor(network()).add_frame(
            frame.image, np.array([[0.8, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]), frame.world_T_cam
        )


def test_the_size_of_an_image_is_looked_at_before_its_pixels(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(path)
    resize_png(path, _Fixed((13_000, 13_000)))  # type: ignore[arg-type]
    for read in (read_image, read_depth):
        with pytest.raises(TFLabError, match=r"a\.png: .*13000x13000 pixels, 0.5 GiB"):
            read(path)


class _Fixed:
    """Chooses what it was told to."""

    def __init__(self, value: tuple[int, int]) -> None:
        self.value = value

    def choice(self, *_: object) -> tuple[int, int]:
        return self.value


# --- arrays, archives, weights -------------------------------------------------------------------


def test_arrays_that_say_they_are_larger_than_their_file(tmp_path: Path) -> None:
    header = io.BytesIO()
    shape = {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6)}
    np.lib.format.write_array_header_1_0(header, shape)
    (tmp_path / "a.npy").write_bytes(header.getvalue() + bytes(100))
    with pytest.raises(TFLabError, match=r"a\.npy: cannot be read as an array"):
        read_array(tmp_path / "a.npy", "")
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("x.npy", header.getvalue() + bytes(100))
    with pytest.raises(TFLabError, match=r"a\.npz: damaged \(it says float64"):
        read_arrays(tmp_path / "a.npz", "")
    np.savez(tmp_path / "b.npz", x=np.array([_Payload()], object))
    with pytest.raises(TFLabError, match=r"b\.npz: damaged"):
        read_arrays(tmp_path / "b.npz", "")
    np.savez(tmp_path / "c.npz", x=np.arange(3), y=np.eye(2))
    assert read_arrays(tmp_path / "c.npz", "")["x"].tolist() == [0, 1, 2]


class _Payload:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, ("touch payload",)


@pytest.mark.parametrize("content", [_Payload(), {"a": torch.zeros(1).expand(10**5, 10**5)}])
def test_weights_that_are_code_or_repeat_themselves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    if isinstance(content, _Payload):
        Path("a.pth").write_bytes(pickle.dumps(content))
    else:
        torch.save(content, "a.pth")
    with pytest.raises(TFLabError, match=r"a\.pth: not a weights file"):
        read_state_dict(Path("a.pth"))
    assert not Path("payload").exists()


@pytest.mark.parametrize("how", range(KINDS))
def test_shards_with_members_that_they_have_no_need_of(
    a_shard: Path, tmp_path: Path, how: int
) -> None:
    """Links, other places, holes of a TiB, sizes that are not there, compression, other content."""
    shards = Path(shutil.copytree(a_shard, tmp_path / "inner" / "shards"))
    change_tar(shards / "chunks-000000.tar", np.random.default_rng(0), how)
    try:
        refused = read_a_shard(shards.parent)
    except TFLabError as error:
        assert "chunks-000000.tar: the shard cannot be read" in str(error)
        refused = True
    assert refused or how in HARMLESS
    assert [p.name for p in tmp_path.iterdir()] == ["inner"]
    assert not Path("/outside").exists()


@pytest.fixture(scope="module")
def a_shard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shards")
    write_a_shard(folder)
    return folder / "shards"
