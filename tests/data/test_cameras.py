"""Every reader's cameras are the right ones: what each pixel shows is where the reader says it is.

The pictures of the box room tell by their colours which point they show. A reader is right if these
points project onto their pixels, and if its depth lifts the pixels onto them. Each case is made so
that the mistake one would make there shows by three pixels or three centimetres at least.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers import box_room
from helpers.layouts import arkit, sens
from helpers.layouts.video import held_upright, write_video
from helpers.lenses import moved
from tf_lab.data.capture import Capture
from tf_lab.data.lens import Camera
from tf_lab.data.readers import open_capture, seven_scenes
from tf_lab.data.readers.frames_of_video import Video, VideoFrame
from tf_lab.data.readers.source import Rig, SourceCapture
from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

RigWriter = Callable[[Path, np.ndarray, np.ndarray], Path]
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
        points = box_room.seen_points(pose, depth, K)
        off = np.linalg.norm(points - box_room.places(capture.image(i)), axis=-1)
        assert (depth > 0).mean() > 0.2
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
    capture = open_capture(tmp_path, ReadSettings(gravity=LEVEL))
    assert pixels_off(capture) < PIXELS
    assert metres_off(capture) < METRES
    # a copy with the depth camera's intrinsics beside the frames is the same sequence
    np.savetxt(tmp_path / "camera-intrinsics.txt", lens((640, 480), 585, (320, 240)))
    copy = open_capture(tmp_path, ReadSettings(gravity=LEVEL))
    np.testing.assert_array_equal(copy.K, capture.K)
    np.testing.assert_array_equal(copy.world_T_cam, capture.world_T_cam)
    # another file is believed: whoever wrote it has registered depth and poses of that camera
    np.savetxt(tmp_path / "camera-intrinsics.txt", lens((640, 480), 575, (319.5, 239.5)))
    assert pixels_off(open_capture(tmp_path, ReadSettings(gravity=LEVEL))) > WRONG_PIXELS
    (tmp_path / "camera-intrinsics.txt").unlink()
    color, depth = seven_scenes.COLOR, seven_scenes.DEPTH
    for one_camera in (Rig(depth), Rig(color), Rig(color, depth)):
        monkeypatch.setattr(seven_scenes, "PUBLISHED", one_camera)
        assert pixels_off(open_capture(tmp_path, ReadSettings(gravity=LEVEL))) > WRONG_PIXELS


COLOR_SIZE, DEPTH_SIZE = (324, 242), (160, 120)
COLOR_K, DEPTH_K = lens(COLOR_SIZE, 180, (161, 122)), lens(DEPTH_SIZE, 100, (77, 61))
COLOR_T_DEPTH = moved([0.01, 0.02, 0], [0.05, 0.02, 0])


def rig_images() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Colour, depth in millimetres and the depth camera's pose, of two cameras side by side."""
    made = []
    for world_T_color in POSES:
        world_T_depth = world_T_color @ COLOR_T_DEPTH
        color = box_room.place_image(world_T_color, COLOR_K, COLOR_SIZE)
        depth = box_room.depth_image(world_T_depth, DEPTH_K, DEPTH_SIZE)
        made.append((color, np.round(depth * 1000).astype(np.uint16), world_T_depth))
    return made


def write_stream(folder: Path, depth_K: np.ndarray, color_T_depth: np.ndarray) -> Path:
    stream = sens.Stream(COLOR_K, COLOR_SIZE, depth_K, DEPTH_SIZE, depth_extrinsics=color_T_depth)
    for color, depth, world_T_depth in rig_images():
        stream.add(color, depth, world_T_depth)
    return stream.write(folder / "scene0000_00.sens")


def write_export(folder: Path, depth_K: np.ndarray, color_T_depth: np.ndarray) -> Path:
    for name in ("color", "depth", "pose", "intrinsic"):
        (folder / name).mkdir(parents=True)
    matrices = {"color": (COLOR_K, np.eye(4)), "depth": (depth_K, color_T_depth)}
    for camera, (K, extrinsics) in matrices.items():
        np.savetxt(folder / "intrinsic" / f"intrinsic_{camera}.txt", sens.intrinsics(K))
        np.savetxt(folder / "intrinsic" / f"extrinsic_{camera}.txt", extrinsics)
    for i, (color, depth, world_T_depth) in enumerate(rig_images()):
        Image.fromarray(color).save(folder / "color" / f"{i}.png")
        Image.fromarray(depth).save(folder / "depth" / f"{i}.png")
        np.savetxt(folder / "pose" / f"{i}.txt", world_T_depth)
    return folder


def write_cpp_export(folder: Path, depth_K: np.ndarray, color_T_depth: np.ndarray) -> Path:
    folder.mkdir()
    lines = ["m_depthShift = 1000"]
    cameras = {
        "Color": (COLOR_K, COLOR_SIZE, np.eye(4)),
        "Depth": (depth_K, DEPTH_SIZE, color_T_depth),
    }
    for kind, (K, (width, height), extrinsics) in cameras.items():
        lines += [f"m_{kind.lower()}Width = {width}", f"m_{kind.lower()}Height = {height}"]
        for what, matrix in (("Intrinsic", sens.intrinsics(K)), ("Extrinsic", extrinsics)):
            lines.append(f"m_calibration{kind}{what} = " + " ".join(map(str, np.ravel(matrix))))
    (folder / "_info.txt").write_text("\n".join(lines))
    for i, (color, depth, world_T_depth) in enumerate(rig_images()):
        Image.fromarray(color).save(folder / f"frame-{i:06d}.color.png")
        Image.fromarray(depth).save(folder / f"frame-{i:06d}.depth.pgm")
        np.savetxt(folder / f"frame-{i:06d}.pose.txt", world_T_depth)
    return folder


@pytest.mark.parametrize("write", [write_stream, write_export, write_cpp_export])
def test_scannet_has_two_cameras(tmp_path: Path, write: RigWriter) -> None:
    capture = open_capture(write(tmp_path / "right", DEPTH_K, COLOR_T_DEPTH))
    assert pixels_off(capture) < PIXELS
    assert metres_off(capture) < METRES
    # what one would get with colour's intrinsics for depth, and without the extrinsics
    shared_K = np.diag([*np.divide(DEPTH_SIZE, COLOR_SIZE), 1]) @ COLOR_K
    assert metres_off(open_capture(write(tmp_path / "K", shared_K, COLOR_T_DEPTH))) > WRONG_METRES
    assert pixels_off(open_capture(write(tmp_path / "one", DEPTH_K, np.eye(4)))) > WRONG_PIXELS


def test_plain_depth_of_another_size_is_of_the_same_camera(tmp_path: Path) -> None:
    """It has the colour camera's K, scaled about the corner of the image."""
    for name in ("images", "depth"):
        (tmp_path / name).mkdir()
    np.savetxt(tmp_path / "K.txt", COLOR_K)
    np.savetxt(tmp_path / "poses.txt", np.reshape(POSES, (-1, 16)))
    factor = 2
    small = lens((162, 121), 180 / factor, tuple((np.array([161, 122]) + 0.5) / factor - 0.5))
    for i, pose in enumerate(POSES):
        image = box_room.place_image(pose, COLOR_K, COLOR_SIZE)
        Image.fromarray(image).save(tmp_path / "images" / f"{i}.png")
        save_depth(tmp_path / "depth" / f"{i}.png", box_room.depth_image(pose, small, (162, 121)))
    capture = open_capture(tmp_path, ReadSettings(gravity=LEVEL))
    assert pixels_off(capture) < PIXELS
    assert metres_off(capture) < METRES
    # depth taken by the K of the colour images as it is
    assert isinstance(capture, SourceCapture)
    same_K = Camera((162, 121), 180.0, 180.0, 161.0, 120.0)
    capture.source = [replace(frame, depth_camera=same_K) for frame in capture.source]
    assert metres_off(capture) > WRONG_METRES


def test_arkit_has_a_camera_for_every_frame(tmp_path: Path) -> None:
    """The phone focuses: its focal length is another in each frame."""
    frames = []
    for i, pose in enumerate(POSES):
        K = lens(COLOR_SIZE, 180 + 12 * i, (160 + i, 121 - i))
        image = box_room.place_image(pose, K, COLOR_SIZE)
        frames.append(Frame(str(i), image, K, pose, box_room.depth_image(pose, K, COLOR_SIZE)))
    folder = arkit.write(tmp_path / "recording", frames)
    capture = open_capture(folder)
    assert pixels_off(capture) < PIXELS
    lines = (folder / "Frames.txt").read_text().splitlines()
    first = lines[0].split(",", 2)[2]
    one_camera = [",".join([*line.split(",")[:2], first]) for line in lines]
    (folder / "Frames.txt").write_text("\n".join(one_camera))
    assert pixels_off(open_capture(folder)) > WRONG_PIXELS


def test_videos_of_upright_phones_are_of_the_upright_camera(tmp_path: Path) -> None:
    """The frames are stored lying; poses and K are of what one sees."""
    size = COLOR_SIZE[::-1]
    K = lens(size, 180, (122, 161))
    (tmp_path / "right").mkdir()
    lying = [np.rot90(box_room.place_image(pose, K, size)) for pose in POSES]
    write_video(tmp_path / "right" / "walk.mov", lying)
    path = tmp_path / "right" / "walk.mov"
    path.write_bytes(held_upright(path.read_bytes()))
    np.savetxt(tmp_path / "right" / "K.txt", K)
    np.savetxt(tmp_path / "right" / "poses.txt", np.reshape(POSES, (-1, 16)))
    capture = open_capture(tmp_path / "right", ReadSettings(gravity=LEVEL))
    assert capture.size == size
    assert pixels_off(capture) < PIXELS
    # the frames as they are stored, with the K of these
    assert isinstance(capture, SourceCapture)
    stored = Camera(COLOR_SIZE, 180.0, 180.0, 161.0, 241 - 122.0)
    video = Video(path, upright=False)
    capture.source = [
        replace(frame, camera=stored, color=VideoFrame(video, i))
        for i, frame in enumerate(capture.source)
    ]
    capture.cameras = [stored] * len(POSES)
    capture.K = np.stack([stored.K] * len(POSES))
    assert pixels_off(capture) > WRONG_PIXELS
