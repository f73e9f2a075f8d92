"""Captures far from the origin of their world, and those in other units than metres."""

import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh

from helpers import box_room
from helpers.layouts import plain
from tf_lab.data.import_capture import ImportSettings, import_capture
from tf_lab.data.readers import open_capture
from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame, Scene
from tf_lab.errors import TFLabError
from tf_lab.meshes.files import read_mesh, write_mesh

UTM = np.array([688123.25, 5334567.5, 512.125])
TURN = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # to a world whose y points down


def frames(scale: float = 1.0, offset: np.ndarray | float = 0.0) -> list[Frame]:
    """The box room in another world, in other units, elsewhere."""
    made = []
    for frame in box_room.frames():
        pose = frame.world_T_cam.copy()
        pose[:3] = TURN @ pose[:3]
        pose[:3, 3] = pose[:3, 3] * scale + offset
        made.append(Frame(frame.name, frame.image, frame.K, pose, frame.depth))
    return made


DOWN = tuple((TURN @ [0.0, 0, -1]).tolist())


def test_far_cameras_are_moved_near(tmp_path: Path) -> None:
    near = open_capture(plain.write(tmp_path / "near", frames()), ReadSettings(gravity=DOWN))
    far = open_capture(
        plain.write(tmp_path / "far", frames(offset=UTM)), ReadSettings(gravity=DOWN)
    )
    back = far.source_T_world @ far.world_T_cam
    np.testing.assert_allclose(back, [f.world_T_cam for f in frames(offset=UTM)], atol=1e-8)
    assert np.abs(far.world_T_cam[:, :3, 3]).max() < 5
    steps = [np.diff(capture.world_T_cam[:, :3, 3], axis=0) for capture in (near, far)]
    np.testing.assert_allclose(*steps, atol=1e-8)
    assert not near.source_T_world[:3, 3].any()


def test_units_and_places_together(tmp_path: Path) -> None:
    source = frames(scale=10, offset=UTM * 10)
    far = open_capture(plain.write(tmp_path / "far", source), ReadSettings(gravity=DOWN, scale=0.1))
    back = far.source_T_world @ far.world_T_cam
    centres = np.stack([frame.world_T_cam[:3, 3] for frame in source])
    np.testing.assert_allclose(back[:, :3, 3], centres, atol=1e-7)
    assert np.abs(far.world_T_cam[:, :3, 3]).max() < 5


def test_ground_truth_of_a_far_capture(tmp_path: Path) -> None:
    """The same surface as near the origin, and the way back leads to the source's coordinates."""
    settings = ImportSettings(*box_room.SIZE, 0, ReadSettings(gravity=DOWN))
    meshes = []
    for name, offset in (("near", 0.0), ("far", UTM)):
        source = plain.write(tmp_path / name, frames(offset=offset))
        import_capture(tmp_path / f"{name}_scene", source, settings, 2**28)
        scene = Scene(tmp_path / f"{name}_scene")
        vertices = read_mesh(scene.groundtruth / "mesh_gt.ply").vertices
        points = vertices @ scene.source_T_world[:3, :3].T + scene.source_T_world[:3, 3]
        meshes.append((points - offset) @ TURN)  # in the room
    for points in meshes:
        np.testing.assert_allclose([points.min(0), points.max(0)], box_room.ROOM, atol=0.04)
        assert np.median(np.abs(box_room.signed_distance(points))) < 0.005


@pytest.mark.parametrize("place", [np.zeros(3), UTM])
def test_written_meshes_keep_millimetres(tmp_path: Path, place: np.ndarray) -> None:
    box = trimesh.creation.box(extents=[0.1, 2.0, 3.0])
    box.apply_translation(place)
    write_mesh(box, tmp_path / "a.ply")
    again = read_mesh(tmp_path / "a.ply")
    np.testing.assert_allclose(again.vertices, box.vertices, atol=1e-6)
    np.testing.assert_array_equal(again.faces, box.faces)


def test_an_empty_mesh_is_written(tmp_path: Path) -> None:
    write_mesh(trimesh.Trimesh(), tmp_path / "a.ply")
    assert len(read_mesh(tmp_path / "a.ply").vertices) == 0


def test_millimetres_are_told(tmp_path: Path) -> None:
    folder = plain.write(tmp_path / "a", frames(scale=1000))
    with pytest.raises(TFLabError, match=r"1,\d\d\d m apart.* scale=0\.001 .*millimetres"):
        open_capture(folder, ReadSettings(gravity=DOWN))
    poses = open_capture(folder, ReadSettings(gravity=DOWN, scale=0.001)).world_T_cam
    assert np.ptp(poses[:, :3, 3], axis=0).max() < 3
    assert (
        np.ptp(open_capture(folder, ReadSettings(scale=1)).world_T_cam[:, :3, 3], axis=0).max()
        > 1000
    )


def test_centimetres_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        open_capture(plain.write(tmp_path / "a", frames(scale=100)), ReadSettings(gravity=DOWN))
    assert "scale=0.01 for centimetres" in caplog.text


def test_one_wild_pose_says_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    wild = frames()
    wild[3].world_T_cam[:3, 3] = 3000
    with caplog.at_level(logging.WARNING):
        open_capture(plain.write(tmp_path / "a", wild), ReadSettings(gravity=DOWN))
    assert not caplog.records
