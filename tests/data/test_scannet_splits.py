"""ScanNet's splits, folders, meshes and labels."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tf_lab.data.scannet_splits import (
    SPLITS,
    find_scene,
    official_mesh,
    split_scenes,
    structure_labels,
)
from tf_lab.data.sources.settings import ScanNetData
from tf_lab.data.sources.source import DataSource, open_source
from tf_lab.errors import TFLabError


def test_the_shipped_splits_are_the_official_ones(tmp_path: Path) -> None:
    scenes = {split: split_scenes(tmp_path / "nowhere", split) for split in SPLITS}
    assert {split: len(names) for split, names in scenes.items()} == {
        "train": 1201,
        "val": 312,
        "test": 100,
    }
    assert all(len(set(names)) == len(names) for names in scenes.values())
    spaces = {split: {name[:9] for name in names} for split, names in scenes.items()}
    assert not spaces["train"] & spaces["val"]
    assert spaces["train"] | spaces["val"] == {f"scene{i:04d}" for i in range(707)}
    assert scenes["test"] == [f"scene{i:04d}_00" for i in range(707, 807)]
    for names in scenes.values():  # the scans of a place are numbered from 0, and stay together
        assert all(f"{name[:-1]}{int(name[-1]) - 1}" in names for name in names if name[-1] != "0")
    assert {"scene0000_00", "scene0000_01", "scene0000_02"} <= set(scenes["train"])
    assert {"scene0568_00", "scene0011_01"} <= set(scenes["val"])


@pytest.mark.parametrize("folder", [".", "..", "Tasks/Benchmark"])
def test_the_user_s_list_wins(tmp_path: Path, folder: str) -> None:
    root = tmp_path / "scannet" / "scans"
    root.mkdir(parents=True)
    (root / folder).mkdir(parents=True, exist_ok=True)
    (root / folder / "scannetv2_val.txt").write_text("scene0002_01\r\nscene0001_00\r\n\r\n")
    assert split_scenes(root, "val") == ["scene0001_00", "scene0002_01"]
    assert len(split_scenes(root, "train")) == 1201


@pytest.mark.parametrize("content", [b"", b"scene0001_00\n0002", b"scene0001\n", b"\xff\xfe\x00"])
def test_a_bad_list_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "scannetv2_train.txt").write_bytes(content)
    with pytest.raises(TFLabError, match=r"scannetv2_train\.txt.*one scene a line"):
        split_scenes(tmp_path, "train")


def test_an_unknown_split(tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match=r"split=dev: ScanNet has train, val, test"):
        split_scenes(tmp_path, "dev")


@pytest.mark.parametrize("folder", ["scans", "scans_test", "."])
def test_scenes_are_found(tmp_path: Path, folder: str) -> None:
    scene = tmp_path / folder / "scene0001_00"
    with pytest.raises(TFLabError, match=r"scans/scene0001_00: no such folder"):
        find_scene(tmp_path, "scene0001_00")
    scene.mkdir(parents=True)
    assert find_scene(tmp_path, "scene0001_00") == scene


def test_the_official_mesh_of_a_folder_or_stream(tmp_path: Path) -> None:
    scene = tmp_path / "scene0001_00"
    scene.mkdir()
    assert official_mesh(scene) is None
    assert official_mesh(scene / "scene0001_00.sens") is None
    mesh = scene / "scene0001_00_vh_clean_2.ply"
    mesh.write_bytes(b"ply")
    (scene / "scene0001_00.sens").write_bytes(b"")
    assert official_mesh(scene) == official_mesh(scene / "scene0001_00.sens") == mesh


POINTS = np.random.default_rng(5).uniform(-3, 3, (6, 3)).astype(np.float32)
LABELS = [1, 2, 3, 0, 40, 22]


def labelled(
    folder: Path, count: int = 6, points: np.ndarray = POINTS, header: str | None = None
) -> Path:
    """A scene with labels as ScanNet writes them."""
    properties = [f"float {axis}" for axis in "xyz"]
    properties += [f"uchar {channel}" for channel in ("red", "green", "blue", "alpha")]
    lines = ["ply", "format binary_little_endian 1.0", "comment MLIB generated"]
    lines += [f"element vertex {count}", *(f"property {p}" for p in properties)]
    lines += ["property ushort label", "element face 1"]
    lines += ["property list uchar int vertex_indices", "end_header\n"]
    vertices = zip(points, LABELS, strict=True)
    data = b"".join(struct.pack("<3f4BH", *point, 9, 9, 9, 255, label) for point, label in vertices)
    scene = folder / "scene0001_00"
    scene.mkdir()
    (scene / "scene0001_00_vh_clean_2.labels.ply").write_bytes(
        (header or "\n".join(lines)).encode() + data + struct.pack("<B3i", 3, 0, 1, 2)
    )
    return scene


def test_floor_and_wall_are_told_from_the_rest(tmp_path: Path) -> None:
    found = structure_labels(labelled(tmp_path))
    assert found is not None
    points, is_structure = found
    assert points.dtype == np.float64
    np.testing.assert_array_equal(points, POINTS)
    np.testing.assert_array_equal(is_structure, [True, True, False, False, False, False])


def test_a_scene_without_labels(tmp_path: Path) -> None:
    assert structure_labels(tmp_path) is None


HEAD = "ply\nformat binary_little_endian 1.0\n"
BAD_HEADERS = [
    "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n",
    "not a ply file",
    HEAD + "element vertex 6\n",
    HEAD + "end_header\n",
    HEAD + "element vertex x\nproperty float x\nend_header\n",
    HEAD + "element vertex -1\nproperty float x\nend_header\n",
    HEAD + "element vertex 1000000000000\nend_header\n",
    HEAD + "element vertex\nproperty float x\nend_header\n",
    HEAD + "element face 1\nproperty list uchar int vertex_indices\nend_header\n",
    HEAD + "element vertex 1\nproperty list uchar int x\nend_header\n",
    HEAD + "element vertex 1\nproperty half x\nend_header\n",
    HEAD + "element vertex 1\nproperty float x\nproperty float x\nend_header\n",
    HEAD + "element vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
]


@pytest.mark.parametrize("header", BAD_HEADERS)
def test_bad_labels_are_named(tmp_path: Path, header: str) -> None:
    with pytest.raises(TFLabError, match=r"labels\.ply: cannot be read"):
        structure_labels(labelled(tmp_path, header=header))


@pytest.mark.parametrize("count", [8, 10**12, 2**63])
def test_more_vertices_declared_than_there_are(tmp_path: Path, count: int) -> None:
    with pytest.raises(TFLabError, match=rf"too short for {count} vertices"):
        structure_labels(labelled(tmp_path, count=count))


def test_vertices_without_a_place(tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match="NaN or infinite"):
        structure_labels(labelled(tmp_path, points=np.where(POINTS < 0, np.nan, POINTS)))


def source(root: Path, **settings: Any) -> DataSource:
    return open_source(ScanNetData(root=str(root), scenes=str(root / "prepared"), **settings))


def test_a_number_of_scenes_is_of_those_that_are_there(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for name in ("scene0011_01", "scene0568_00", "scene0568_01"):  # of 312
        (tmp_path / "scans" / name).mkdir(parents=True)
    assert list(source(tmp_path, val_size=2).captures(("val",))["val"]) == [
        *("scene0011_01", "scene0568_00")
    ]
    assert "are missing" not in caplog.text
    assert "2 of 2 val scenes have no official mesh" in caplog.text
    assert len(source(tmp_path).captures(("val",))["val"]) == 3
    assert "309 of 312 val scenes are missing" in caplog.text


def test_a_split_without_any_scene_says_how_to_go_without(tmp_path: Path) -> None:
    (tmp_path / "scans" / "scene0000_00").mkdir(parents=True)
    with pytest.raises(TFLabError, match=r"no test scene in it; data\.test_size=0 goes without"):
        source(tmp_path).captures(("test",))
    found = source(tmp_path, test_size=0, val_size=0).captures(("train", "val", "test"))
    assert {split: list(scenes) for split, scenes in found.items()} == {
        **{"train": ["scene0000_00"], "val": [], "test": []}
    }


def test_a_scene_in_two_lists_is_refused(tmp_path: Path) -> None:
    (tmp_path / "scannetv2_train.txt").write_text("scene0000_00\nscene0707_00\n")
    with pytest.raises(TFLabError, match="scene0707_00 is in the list of the train scenes, and"):
        source(tmp_path).captures(("train",))
    (tmp_path / "scans" / "scene0707_00").mkdir(parents=True)
    assert source(tmp_path, test_size=0).captures(("train",))["train"]  # nothing is held out
