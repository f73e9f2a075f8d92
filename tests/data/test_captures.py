"""Captures made into scenes: what is kept, what is left out, and what is true of it."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import trimesh

from helpers.layouts import plain, room_frames, sens, seven_scenes
from tf_lab.data import prepare_captures as preparing
from tf_lab.data.groundtruth import GroundTruth
from tf_lab.data.import_capture import ImportSettings, import_capture
from tf_lab.data.prepare_captures import find_captures, names_of, prepare_captures, summarise
from tf_lab.data.readers import detect_format, open_capture
from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Scene
from tf_lab.data.sources.settings import CapturesData
from tf_lab.data.sources.source import open_source
from tf_lab.errors import TFLabError
from tf_lab.geometry import pose_distance
from tf_lab.meshes.files import read_mesh, write_mesh

READ = ReadSettings(gravity=(0.0, 0.0, -1.0))
SMALL = ImportSettings(width=48, height=36, keyframe_distance=0.0, read=READ)
MEMORY = 2**28


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return seven_scenes.write(tmp_path / "captures" / "kitchen", room_frames())


def imported(source: Path, directory: Path, settings: ImportSettings = SMALL) -> Scene:
    import_capture(directory, source, settings, MEMORY)
    return Scene(directory)


def test_a_scene_has_the_frames_at_the_wanted_size(source: Path, tmp_path: Path) -> None:
    scene, capture = (
        imported(source, tmp_path / "scene"),
        open_capture(source, READ),
    )
    assert (scene.name, scene.size, scene.frames) == ("kitchen", (48, 36), capture.frames)
    np.testing.assert_array_equal(scene.world_T_cam, capture.world_T_cam)
    # half the size: the same rays through the corners of the image
    corners = np.array([[-0.5, -0.5, 1], [95.5, 71.5, 1]])
    rays = np.linalg.solve(capture.K[0], corners.T)
    halved = np.linalg.solve(scene.K[0], np.array([[-0.5, -0.5, 1], [47.5, 35.5, 1]]).T)
    np.testing.assert_allclose(rays, halved, atol=1e-9)
    shrunk = capture.image(3).reshape(36, 2, 48, 2, 3).mean((1, 3))
    assert np.abs(scene.image(3) - shrunk).mean() < 4  # JPEG
    depth = scene.depth(3)
    assert depth is not None
    blocks = capture.depth(3).reshape(36, 2, 48, 2)  # type: ignore[union-attr]
    assert ((depth[:, None, :, None] - blocks).__abs__().min((1, 3)) < 1e-3).all()
    assert len(GroundTruth(scene.groundtruth).centers)


def test_keyframes_alone_are_stored(source: Path, tmp_path: Path) -> None:
    far = ImportSettings(48, 36, keyframe_distance=0.5, read=READ)
    scene = imported(source, tmp_path / "scene", far)
    assert 2 < len(scene) < len(room_frames())
    steps = zip(scene.world_T_cam[:-1], scene.world_T_cam[1:], strict=True)
    assert min(pose_distance(a, b)[0] for a, b in steps) >= 0.5


def test_bad_frames_are_left_out_and_listed(source: Path, tmp_path: Path) -> None:
    color = source / "frame-000003.color.png"
    color.write_bytes(color.read_bytes()[:200])
    (source / "frame-000005.depth.png").write_bytes(b"")
    (source / "frame-000007.depth.png").unlink()
    (source / "frame-000009.pose.txt").write_text("nan " * 16)
    scene = imported(source, tmp_path / "scene")
    assert len(scene) == len(room_frames()) - 4
    lost = dict(line.split(": ", 1) for line in scene.skipped)
    assert set(lost) == {f"frame-00000{i}" for i in (3, 5, 7, 9)}
    assert "cannot be read as an image" in lost["frame-000003"]
    assert "depth image" in lost["frame-000005"]
    assert "no depth" in lost["frame-000007"]
    assert "NaN" in lost["frame-000009"]
    assert not {p.stem for p in (scene.directory / "color").iterdir()} & set(lost)


def test_nothing_usable_is_an_error(source: Path, tmp_path: Path) -> None:
    for path in source.glob("*.depth.png"):
        path.unlink()
    with pytest.raises(TFLabError, match=r"kitchen: no usable frame.*no depth"):
        imported(source, tmp_path / "scene")


TURN = np.array([[1.0, 0, 0, 0.3], [0, 0, -1, 0.1], [0, 1, 0, -2], [0, 0, 0, 1]])


def turned(folder: Path) -> tuple[Path, ImportSettings]:
    """The room in a world whose z axis points down its own y, and how it is read."""
    frames = [type(f)(f.name, f.image, f.K, TURN @ f.world_T_cam, f.depth) for f in room_frames()]
    read = ReadSettings(gravity=tuple(TURN[:3, :3] @ [0, 0, -1]))
    return plain.write(folder, frames), ImportSettings(48, 36, 0.0, read=read)


def test_a_turned_world_is_brought_upright(tmp_path: Path) -> None:
    """The scene is z-up and knows the way back."""
    source, settings = turned(tmp_path / "turned")
    scene = imported(source, tmp_path / "scene", settings)
    back = scene.source_T_world @ scene.world_T_cam
    expected = np.stack([TURN @ f.world_T_cam for f in room_frames()])
    np.testing.assert_allclose(back, expected, atol=1e-9)
    straight = imported(plain.write(tmp_path / "straight", room_frames()), tmp_path / "scene2")
    meshes = [read_mesh(s.groundtruth / "mesh_gt.ply") for s in (scene, straight)]
    heights = [np.ptp(np.asarray(mesh.vertices)[:, 2]) for mesh in meshes]
    assert heights[0] == pytest.approx(heights[1], abs=0.05)


def test_an_official_mesh_is_the_ground_truth(tmp_path: Path) -> None:
    """It is in the source's world; the scene's is another."""
    source, settings = turned(tmp_path / "turned")
    official = trimesh.creation.icosphere(radius=0.5).apply_transform(TURN)
    write_mesh(official, source / "turned_vh_clean_2.ply")
    scene = imported(source, tmp_path / "scene", settings)
    truth = read_mesh(scene.groundtruth / "mesh_gt.ply")
    back = trimesh.transform_points(truth.vertices, scene.source_T_world)
    np.testing.assert_allclose(back, official.vertices, atol=1e-5)


def test_many_lost_frames_make_a_warning(source: Path, tmp_path: Path) -> None:
    def warning(name: str) -> object:
        import_capture(tmp_path / name, source, SMALL, MEMORY, check=False)
        return Scene(tmp_path / name).provenance["warning"]

    assert warning("whole") is None
    for path in sorted(source.glob("*.pose.txt"))[:6]:
        path.write_text("nan " * 16)
    reason = "the pose has NaN or infinity (frame lost)"
    assert warning("cut") == f"6 of 24 frames are left out, most as {reason}"


def test_one_bad_capture_does_not_stop_the_others(source: Path, tmp_path: Path) -> None:
    bad = seven_scenes.write(source.parent / "bad", room_frames()[:3])
    (bad / "camera-intrinsics.txt").write_text("1 2 3")
    (source.parent / "notes").mkdir()
    found = find_captures(source.parent)
    assert list(found) == ["bad", "kitchen"]
    root = tmp_path / "scenes"
    prepared = prepare_captures(found, root, SMALL, workers=1, memory=MEMORY)
    assert list(prepared.scenes) == ["kitchen"]
    assert "camera-intrinsics.txt" in prepared.failed["bad"]
    text = summarise(prepared, root / SMALL.key)
    assert "1 scene, 24 frames" in text
    saved = json.loads((root / SMALL.key / "prepare.json").read_text())
    assert saved["scenes"]["kitchen"]["frames"] == 24
    assert "camera-intrinsics.txt" in saved["failed"]["bad"]
    # what is there is kept, what failed is tried again
    stamp = prepared.scenes["kitchen"].stat().st_ino
    np.savetxt(bad / "camera-intrinsics.txt", room_frames()[0].K)
    again = prepare_captures(found, root, SMALL, workers=1, memory=MEMORY)
    assert (again.failed, again.scenes["kitchen"].stat().st_ino) == ({}, stamp)


def test_captures_behind_links_keep_their_own_names(source: Path, tmp_path: Path) -> None:
    """7-Scenes has a `seq-01` of every place."""
    root = tmp_path / "links"
    root.mkdir()
    for name in ("kitchen", "office"):
        real = tmp_path / name / "seq-01"
        shutil.copytree(source, real)
        (root / name).symlink_to(real)
    found = find_captures(root)
    made = prepare_captures(found, tmp_path / "scenes", SMALL, workers=1, memory=MEMORY).scenes
    assert {name: Scene(path).name for name, path in made.items()} == {n: n for n in found}


def test_only_preparing_writes_what_became_of_all_scenes(source: Path, tmp_path: Path) -> None:
    """A training, which may need but some of them, says nothing of the others."""
    settings = CapturesData(
        root=str(source.parent), scenes=str(tmp_path / "scenes"), width=48, height=36, workers=1
    )
    opened = open_source(settings)
    assert list(opened.scenes("train")["train"]) == ["kitchen"]
    assert not list((tmp_path / "scenes").rglob("prepare.json"))
    opened.prepare(["train"])
    assert len(list((tmp_path / "scenes").rglob("prepare.json"))) == 1


def test_other_settings_are_other_scenes() -> None:
    others = [ImportSettings(), ImportSettings(320, 240), ImportSettings(keyframe_distance=0.2)]
    assert len({settings.key for settings in others}) == 3


def test_no_capture(tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match="no such folder"):
        find_captures(tmp_path / "nowhere")
    with pytest.raises(TFLabError, match=r"no capture in it.*docs/data\.md"):
        find_captures(tmp_path)


def test_a_root_with_other_things_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    frames = room_frames()[:1]
    plain.write(tmp_path / "kitchen", frames)
    for name in ("kitchen", "hall"):
        sens.write(tmp_path / "scan", frames).rename(tmp_path / f"{name}.sens")
    for name in ("kitchen.mp4", "prepare.json", "notes.txt", ".hidden.sens"):
        (tmp_path / name).write_bytes(b"{}")
    for name in ("scan", "locked"):
        (tmp_path / name).mkdir(exist_ok=True)

    def refusing(path: Path) -> list[str]:
        if path.name == "locked":  # as stat does for a folder of another user
            raise PermissionError(13, "Permission denied", str(path))
        return detect_format(path)

    monkeypatch.setattr(preparing, "detect_format", refusing)
    assert find_captures(tmp_path) == {
        "kitchen": tmp_path / "kitchen",
        "kitchen.sens": tmp_path / "kitchen.sens",
        "hall": tmp_path / "hall.sens",
    }
    assert f"{tmp_path / 'locked'}: left out, it cannot be read (Permission denied)" in caplog.text


@pytest.mark.parametrize("given", ["scans", "scans/kitchen/seq-01"])
def test_the_folder_that_holds_the_captures_is_told(tmp_path: Path, given: str) -> None:
    sequence = tmp_path / "scans" / "kitchen" / "seq-01"
    seven_scenes.write(sequence, room_frames())
    with pytest.raises(TFLabError, match=f"the folder that holds them is {sequence.parent}"):
        find_captures(tmp_path / given)


@pytest.mark.parametrize("given", [["a", "c"], "FILE"])
def test_names_of_a_split(tmp_path: Path, given: Sequence[str]) -> None:
    if given == "FILE":
        (tmp_path / "split.txt").write_text("# two\na\nc\n", encoding="utf-8-sig")
        given = str(tmp_path / "split.txt")
    assert names_of(given, ["a", "b", "c"], "data.val") == ["a", "c"]
    with pytest.raises(TFLabError, match=r"data\.val: c: not there; there are: a, b"):
        names_of(given, ["a", "b"], "data.val")


def test_a_missing_split_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match=r"val\.txt: missing; data\.val is a list"):
        names_of(str(tmp_path / "val.txt"), ["a"], "data.val")


def depth_difference(scene: Scene, frame: int) -> np.ndarray:
    """|depth of the ground-truth mesh - reading| (m) at every third pixel that has both."""
    mesh = read_mesh(scene.groundtruth / "mesh_gt.ply")
    depth, pose = scene.depth(frame), scene.world_T_cam[frame]
    assert depth is not None
    row, column = np.nonzero(depth)
    row, column = row[::3], column[::3]
    pixels = np.stack([column, row, np.ones(len(row))])
    rays = (pose[:3, :3] @ np.linalg.solve(scene.K[frame], pixels)).T  # of camera z 1
    origins = np.tile(pose[:3, 3], (len(rays), 1))
    points, hit, _ = mesh.ray.intersects_location(origins, rays, multiple_hits=False)
    z = (points - pose[:3, 3]) @ pose[:3, 2]
    return np.abs(z - depth[row[hit], column[hit]])


def test_redkitchen_fused_agrees_with_its_depth(redkitchen: Path, tmp_path: Path) -> None:
    scene = imported(redkitchen, tmp_path / "scene", ImportSettings(320, 240))
    assert (len(scene) > 30, scene.skipped) == (True, [])
    for frame in (0, len(scene) // 2, len(scene) - 1):
        difference = depth_difference(scene, frame)
        assert len(difference) > 10_000
        assert np.median(difference) < 0.015
