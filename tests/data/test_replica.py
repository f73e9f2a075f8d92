"""Replica as NICE-SLAM publishes it: which pose is whose, and where the camera is found."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.layouts import replica as layout, room_frames
from tf_lab.data.readers import open_capture, replica
from tf_lab.errors import TFLabError

FRAMES = room_frames()[:4]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return layout.write(tmp_path / "Replica", FRAMES)


def test_poses_go_by_the_number_of_the_frame(scene: Path) -> None:
    for name in ("frame000001", "depth000001", "depth000002"):
        (scene / "results" / f"{name}.png").unlink()
    lines = (scene / "traj.txt").read_text().splitlines()
    (scene / "traj.txt").write_text("\n".join(lines[:3]))
    capture = replica.read(scene)
    assert capture.frames == ["frame000000", "frame000002"]
    assert capture.skipped == ["frame000003: traj.txt has only 3 lines"]
    for i, frame in enumerate((FRAMES[0], FRAMES[2])):
        np.testing.assert_allclose(capture.world_T_cam[i], frame.world_T_cam)
        np.testing.assert_array_equal(capture.image(i), frame.image)
    np.testing.assert_allclose(capture.depth(0), FRAMES[0].depth, atol=1e-3)
    assert capture.depth(1) is None
    assert capture.down == (0, 0, -1)


def test_the_camera_beside_the_scenes_or_in_one(scene: Path, tmp_path: Path) -> None:
    expected = replica.read(scene).K
    file = scene.parent / "cam_params.json"
    file.rename(scene / "cam_params.json")
    np.testing.assert_array_equal(replica.read(scene).K, expected)
    (scene / "cam_params.json").unlink()
    with pytest.raises(TFLabError, match=r"cam_params\.json: missing; .*beside the scene or in it"):
        open_capture(scene)


def test_the_camera_beside_a_link(scene: Path, tmp_path: Path) -> None:
    expected = replica.read(scene).K
    links = tmp_path / "links"
    links.mkdir()
    (links / "room0").symlink_to(scene)
    (scene.parent / "cam_params.json").rename(links / "cam_params.json")
    np.testing.assert_array_equal(open_capture(links / "room0").K, expected)


@pytest.mark.parametrize("camera", [None, {"scale": 0}, {"scale": "x"}, {"fx": -1}, {"w": None}])
def test_a_camera_that_is_none(scene: Path, camera: dict[str, Any] | None) -> None:
    file = scene.parent / "cam_params.json"
    document = json.loads(file.read_text())
    document["camera"] = None if camera is None else {**document["camera"], **camera}
    file.write_text(json.dumps(document))
    with pytest.raises(TFLabError, match=r"cam_params\.json: "):
        open_capture(scene)
