"""Every reader's cameras are the right ones: what each pixel shows is where the reader says it is.

The pictures of the box room tell by their colours which point they show. A reader is right if these
points project onto their pixels, and if its depth lifts the pixels onto them. Each case is made so
that the mistake one would make there shows by three pixels or three centimetres at least.
"""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import box_room
from lenses import moved
from tf_lab.data.capture import Capture
from tf_lab.data.readers import open_capture, seven_scenes
from tf_lab.data.readers.source import Rig

POSES = box_room.poses()[3::6]
LEVEL = [0, 0, -1]
PIXELS, METRES = 1.5, 0.01  # right cameras: a colour tells a place to 6 mm
WRONG_PIXELS, WRONG_METRES = 3.0, 0.03


def lens(size: tuple[int, int], focal: float, centre: tuple[float, float]) -> np.ndarray:
    return np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])


def save_depth(path: Path, depth: np.ndarray) -> None:
    Image.fromarray(np.round(depth * 1000).astype(np.uint16)).save(path)


def pixels_off(capture: Capture) -> float:
    """How far points are seen from where the cameras have them, pixels (median of all)."""
    distances = []
    for i, pose in enumerate(capture.world_T_cam):
        points = box_room.places(capture.image(i)) - pose[:3, 3]
        u, v, z = np.moveaxis(points @ pose[:3, :3] @ capture.K[i].T, -1, 0)
        rows, columns = np.indices(u.shape)
        distances.append(np.hypot(u / z - columns, v / z - rows))
    return float(np.median(distances))


def metres_off(capture: Capture) -> float:
    """How far depth has points from where they are, metres (median of all)."""
    distances = []
    for i, (pose, K) in enumerate(zip(capture.world_T_cam, capture.K, strict=True)):
        depth = capture.depth(i)
        assert depth is not None
        points = box_room._seen(pose, depth, K)
        off = np.linalg.norm(points - box_room.places(capture.image(i)), axis=-1)
        assert (depth > 0).mean() > 0.8
        distances.append(off[depth > 0])
    return float(np.median(np.concatenate(distances)))


def write_published(directory: Path) -> None:
    """A 7-Scenes sequence as published: the colour camera 25 mm to the right of the depth's."""
    color_K, depth_K = lens((640, 480), 525, (320, 240)), lens((640, 480), 585, (320, 240))
    for i, world_T_depth in enumerate(POSES):
        world_T_color = world_T_depth @ moved([0, 0, 0], [0.025, 0, 0])
        stem = directory / f"frame-{i:06d}"
        image = box_room.place_image(world_T_color, color_K, (640, 480))
        Image.fromarray(image).save(f"{stem}.color.png")
        save_depth(
            Path(f"{stem}.depth.png"), box_room.depth_image(world_T_depth, depth_K, (640, 480))
        )
        np.savetxt(f"{stem}.pose.txt", world_T_depth)


def test_seven_scenes_as_published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_published(tmp_path)
    capture = open_capture(tmp_path, gravity=LEVEL)
    assert pixels_off(capture) < PIXELS
    assert metres_off(capture) < METRES
    # a copy with the depth camera's intrinsics beside the frames is the same sequence
    np.savetxt(tmp_path / "camera-intrinsics.txt", lens((640, 480), 585, (320, 240)))
    copy = open_capture(tmp_path, gravity=LEVEL)
    np.testing.assert_array_equal(copy.K, capture.K)
    np.testing.assert_array_equal(copy.world_T_cam, capture.world_T_cam)
    # another file is believed: whoever wrote it has registered depth and poses of that camera
    np.savetxt(tmp_path / "camera-intrinsics.txt", lens((640, 480), 575, (319.5, 239.5)))
    assert pixels_off(open_capture(tmp_path, gravity=LEVEL)) > WRONG_PIXELS
    (tmp_path / "camera-intrinsics.txt").unlink()
    color, depth = seven_scenes.COLOR, seven_scenes.DEPTH
    for one_camera in (Rig(depth), Rig(color), Rig(color, depth)):
        monkeypatch.setattr(seven_scenes, "PUBLISHED", one_camera)
        assert pixels_off(open_capture(tmp_path, gravity=LEVEL)) > WRONG_PIXELS


COLOR_SIZE, DEPTH_SIZE = (324, 242), (160, 120)
COLOR_K, DEPTH_K = lens(COLOR_SIZE, 180, (161, 122)), lens(DEPTH_SIZE, 100, (77, 61))
