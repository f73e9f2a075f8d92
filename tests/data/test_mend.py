"""What a source says wrongly, injected; the setting that says so gives the right capture back."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from helpers.layouts import LAYOUTS, room_frames
from tf_lab.data.capture import Capture
from tf_lab.data.import_capture import ImportSettings
from tf_lab.data.readers import open_capture
from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame
from tf_lab.data.sources.settings import CapturesData
from tf_lab.errors import TFLabError

DOWN = (0.0, 0.0, -1.0)
COUNT = 8


def frames(**changes: object) -> list[Frame]:
    return [replace(frame, **changes) for frame in room_frames()[:COUNT]]  # type: ignore[arg-type]


def posed(poses: list[np.ndarray]) -> list[Frame]:
    return [replace(f, world_T_cam=p) for f, p in zip(frames(), poses, strict=True)]


def opened(tmp_path: Path, wrong: list[Frame], layout: str = "plain", **mends: object) -> Capture:
    module = LAYOUTS[layout]
    folder = module.write(tmp_path / "room", wrong)
    return open_capture(folder, replace(module.OPTIONS, **mends))


def assert_right(capture: Capture, first: int = 0, count: int = COUNT) -> None:
    right = frames()[first : first + count]
    assert len(capture.frames) == count
    np.testing.assert_allclose(
        capture.world_T_cam, np.stack([f.world_T_cam for f in right]), atol=1e-5
    )
    np.testing.assert_allclose(capture.K, np.stack([f.K for f in right]), atol=1e-5)


def true_poses() -> list[np.ndarray]:
    return [frame.world_T_cam.copy() for frame in frames()]


def transposed(pose: np.ndarray) -> np.ndarray:
    wrong = pose.copy()
    wrong[:3, :3] = pose[:3, :3].T
    return wrong


@pytest.mark.parametrize("layout", ["plain", "seven_scenes", "tum", "scannet", "transforms"])
def test_inverted_poses(tmp_path: Path, layout: str) -> None:
    wrong = posed([np.linalg.inv(pose) for pose in true_poses()])
    if layout == "transforms":  # inverse of the OpenGL pose: the axes are on the other side
        gl = np.diag([1.0, -1, -1, 1])
        wrong = posed([gl @ np.linalg.inv(pose) @ gl for pose in true_poses()])
    assert_right(opened(tmp_path, wrong, layout, poses="world_to_camera"))


def test_poses_of_a_model_that_were_inverted_already(tmp_path: Path) -> None:
    """COLMAP's are world to camera; someone wrote camera to world."""
    inverted = posed([np.linalg.inv(pose) for pose in true_poses()])
    assert_right(opened(tmp_path, inverted, "colmap_text", poses="camera_to_world"))


# where the named camera's x, y and z point, in (right, down, forward)
AXES = {
    "opengl": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "ros": [[0, 0, 1], [-1, 0, 0], [0, -1, 0]],
    "drb": [[0, 1, 0], [1, 0, 0], [0, 0, -1]],
    "luf": [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
}


@pytest.mark.parametrize("name", list(AXES))
def test_axes(tmp_path: Path, name: str) -> None:
    turn = np.eye(4)
    turn[:3, :3] = np.array(AXES[name], np.float64).T
    wrong = posed([pose @ turn for pose in true_poses()])
    assert_right(opened(tmp_path, wrong, axes=name))


def test_left_handed_axes_have_a_left_handed_world(tmp_path: Path) -> None:
    """Unity: y up, x right, z forward, all of it mirrored; the way back leads there."""
    world = np.eye(4)[[0, 2, 1, 3]]  # z up and right-handed to y up and left-handed
    camera = np.diag([1.0, -1, 1, 1])
    written = [world @ pose @ camera for pose in true_poses()]
    capture = opened(tmp_path, posed(written), axes="unity", gravity=(0.0, -1.0, 0.0))
    turn = capture.world_T_cam @ np.linalg.inv(true_poses())  # one turn about the vertical
    np.testing.assert_allclose(turn, np.broadcast_to(turn[0], turn.shape), atol=1e-6)
    np.testing.assert_allclose(turn[0, 2, :3], [0, 0, 1], atol=1e-6)
    assert np.linalg.det(turn[0]) == pytest.approx(1)
    back = capture.source_T_world @ capture.world_T_cam
    np.testing.assert_allclose(back[:, :3, 3], np.stack(written)[:, :3, 3], atol=1e-6)


def test_transposed_rotations(tmp_path: Path) -> None:
    wrong = posed([transposed(pose) for pose in true_poses()])
    assert_right(opened(tmp_path, wrong, rotations="transposed"))


@pytest.mark.parametrize(("layout", "order"), [("tum", "wxyz"), ("colmap_text", "xyzw")])
def test_the_order_of_quaternions(tmp_path: Path, layout: str, order: str) -> None:
    """The numbers are written in the other order than the layout has them."""
    wrong = []
    for pose in true_poses():
        rotation, written = pose[:3, :3], pose.copy()
        x, y, z, w = Rotation.from_matrix(rotation if layout == "tum" else rotation.T).as_quat()
        misread = [w, x, y, z] if layout == "tum" else [y, z, w, x]  # as (x, y, z, w)
        matrix = Rotation.from_quat(misread).as_matrix()
        if layout == "tum":
            written[:3, :3] = matrix
        else:  # its translation stays: -R^T c of the right rotation
            translation = -rotation.T @ pose[:3, 3]
            written[:3, :3], written[:3, 3] = matrix.T, -matrix.T @ translation
        wrong.append(written)
    assert_right(opened(tmp_path, posed(wrong), layout, quaternions=order))


def test_a_layout_without_quaternions_has_no_order_of_them(tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match=r"quaternions=xyzw: .*has no quaternions"):
        opened(tmp_path, frames(), quaternions="xyzw")


def test_intrinsics(tmp_path: Path) -> None:
    K = frames()[0].K
    wrong = K * [[1.25, 1.25, 1], [1.25, 1.25, 1], [1, 1, 1]]
    wrong[:2, 2] = K[:2, 2] + [3, -2]
    capture = opened(tmp_path, frames(K=wrong), focal_scale=0.8, principal=(-3, 2))
    assert_right(capture)
    assert_right(opened(tmp_path / "b", frames(K=wrong), focal_scale=0.8, principal="center"))


def test_images_resized_without_their_intrinsics(tmp_path: Path) -> None:
    K, (height, width) = frames()[0].K, frames()[0].image.shape[:2]
    full = np.array([[3.0, 0, 1.0], [0, 3, 1.0], [0, 0, 1]]) @ K  # pixel centres at integers
    with pytest.raises(TFLabError, match=r"outside the 96x72.*intrinsics_size="):
        opened(tmp_path, frames(K=full))
    mended = {"intrinsics_size": (3 * width, 3 * height)}
    assert_right(opened(tmp_path / "b", frames(K=full), **mended))


@pytest.mark.parametrize("turn", [90, 180, 270])
@pytest.mark.parametrize("intrinsics", ["of the poses", "of the images"])
def test_turned_images(tmp_path: Path, turn: int, intrinsics: str) -> None:
    """The images were turned back by as much: turning them again gives those of the poses."""
    wrong = []
    for frame in frames():
        K = frame.K.copy()
        if intrinsics == "of the images" and turn != 180:
            height, width = frame.image.shape[:2]
            cx, cy = K[:2, 2]
            K = K[[1, 0, 2]][:, [1, 0, 2]]
            K[:2, 2] = (cy, width - 1 - cx) if turn == 90 else (height - 1 - cy, cx)
        stored = [np.rot90(pixels, turn // 90) for pixels in (frame.image, frame.depth)]
        wrong.append(replace(frame, image=stored[0], depth=stored[1], K=K))
    capture = opened(tmp_path, wrong, turn=turn)
    assert_right(capture)
    np.testing.assert_array_equal(capture.image(3), frames()[3].image)
    np.testing.assert_allclose(capture.depth(3), frames()[3].depth, atol=0.0011)


@pytest.mark.parametrize("layout", ["transforms", "colmap_text", "polycam", "record3d"])
@pytest.mark.parametrize("factor", [1, 2])
def test_the_size_that_intrinsics_are_of_is_counted_once(
    tmp_path: Path, layout: str, factor: int
) -> None:
    """Of images made smaller since, where the layout says which size its intrinsics are of, too."""
    module = LAYOUTS[layout]
    folder = module.write(tmp_path / "room", frames())
    height, width = frames()[0].image.shape[:2]
    right = open_capture(folder, module.OPTIONS).K / [[2], [2], [1]]
    for file in folder.rglob("*"):
        if file.suffix in (".png", ".jpg") and "depth" not in str(file) and "conf" not in str(file):
            with Image.open(file) as image:
                small = image.resize((width // 2, height // 2))
            small.save(file)
    stated = (factor * width, factor * height)
    told = replace(module.OPTIONS, intrinsics_size=stated)
    without, found = (open_capture(folder, how).K for how in (module.OPTIONS, told))
    np.testing.assert_allclose(without[:, :2, :2], right[:, :2, :2], rtol=1e-6)
    np.testing.assert_allclose(found[:, 0, 0], right[:, 0, 0] / factor, rtol=1e-6)


@pytest.mark.parametrize("shift", [2, -2])
def test_poses_shifted_against_the_images(tmp_path: Path, shift: int) -> None:
    """Frame i was given the pose of frame i - shift; those at the end have none."""
    poses = true_poses()
    poses[4][:3, 3] = np.nan  # lost frames count
    wrong = posed([poses[min(max(i - shift, 0), COUNT - 1)] for i in range(COUNT)])
    capture = opened(tmp_path, wrong, shift=shift)
    expected = [str(i) for i in range(max(0, -shift), COUNT - max(0, shift)) if i != 4]
    assert capture.frames == expected
    lost = [line for line in capture.skipped if f"shift={shift}: no frame is that" in line]
    assert len(lost) == abs(shift)
    right = np.stack([frames()[int(name)].world_T_cam for name in expected])
    np.testing.assert_allclose(capture.world_T_cam, right, atol=1e-6)


@pytest.mark.parametrize("layout", ["plain", "tum", "sens", "transforms"])
def test_the_unit_of_depth(tmp_path: Path, layout: str) -> None:
    stated = {"plain": 1000, "tum": 5000, "sens": 1000, "transforms": 10000}[layout]
    wrong = [replace(f, depth=f.depth / 2) for f in frames()]
    capture = opened(tmp_path, wrong, layout, depth_scale=stated / 2)
    np.testing.assert_allclose(capture.depth(2), frames()[2].depth, atol=0.0021)


def test_depth_may_keep_the_intrinsics(tmp_path: Path) -> None:
    """Colour of a longer lens than depth: the plane that depth sees keeps its place."""
    scale = 1.2
    for camera in ("shared", "as_given"):
        capture = opened(tmp_path / camera, frames(), focal_scale=scale, depth_camera=camera)
        depth, truth = capture.depth(0), frames()[0].depth
        assert depth is not None
        height, width = depth.shape
        column, row = width - 20, height - 20
        cx, cy = frames()[0].K[:2, 2]
        there = round(cy + (row - cy) / scale), round(cx + (column - cx) / scale)
        expected = truth[row, column] if camera == "shared" else truth[there]
        assert depth[row, column] == pytest.approx(expected, abs=0.0011)
    assert truth[row, column] != pytest.approx(truth[there], abs=0.01)  # else nothing is tested


@pytest.mark.parametrize(
    ("mend", "told"),
    [
        ({"poses": "inverted"}, "poses=inverted: choose camera_to_world or world_to_camera"),
        ({"axes": "blender"}, "axes=blender: choose opencv, opengl, unity.*rdf"),
        ({"axes": "rrf"}, "axes=rrf: choose"),
        ({"rotations": "t"}, "rotations=t: choose as_given or transposed"),
        ({"quaternions": "zyxw"}, "quaternions=zyxw: choose wxyz or xyzw"),
        ({"focal_scale": 0.0}, "focal_scale=0.0: .*positive"),
        ({"focal_scale": None}, "focal_scale=None"),
        ({"principal": "middle"}, r"principal=middle: choose center, or \[x,y\]"),
        ({"principal": (1.0,)}, "principal="),
        ({"intrinsics_size": (0, 10)}, r"intrinsics_size=\(0, 10\): \[width,height\]"),
        ({"depth_camera": "own"}, "depth_camera=own: choose shared or as_given"),
        ({"turn": 45}, "turn=45: choose 0 or 90 or 180 or 270"),
        ({"shift": 0.5}, "shift=0.5: a whole number"),
        ({"depth_scale": -1.0}, "depth_scale=-1.0: units per metre"),
        ({"scale": float("nan")}, "scale=nan: metres per unit"),
    ],
)
def test_values_that_cannot_be(mend: dict[str, object], told: str) -> None:
    with pytest.raises(TFLabError, match=told):
        ReadSettings(**mend)  # type: ignore[arg-type]


def test_depth_without_a_unit(tmp_path: Path) -> None:
    """Nothing to do, where there is no depth."""
    assert opened(tmp_path, frames(), "video", depth_scale=100.0).depth(0) is None


def test_the_settings_are_part_of_a_scene() -> None:
    keys = {ImportSettings(read=ReadSettings(axes=axes)).key for axes in (None, "opengl", "ros")}
    assert len(keys) == 3
    settings: Any = [1, 2]  # as a config has it
    captures = CapturesData(shift=2, principal=settings)
    assert captures.read == ReadSettings(shift=2, principal=(1, 2))


def test_colour_images_are_not_touched(tmp_path: Path) -> None:
    """Mends of poses leave the pixels alone."""
    folder = LAYOUTS["plain"].write(tmp_path / "room", frames())
    capture = open_capture(folder, ReadSettings(gravity=DOWN, axes="opengl"))
    with Image.open(folder / "images" / "1.png") as image:
        np.testing.assert_array_equal(capture.image(1), np.asarray(image))


def test_settings_take_numpys_values() -> None:
    """As where a caller computes them; they are the same settings."""
    of_numpy: dict[str, Any] = {
        "scale": np.float32(0.5),
        "depth_scale": np.int64(1000),
        "turn": np.int64(90),
        "principal": np.array([1.0, 2.0]),
        "gravity": np.array([0, 0, -1.0]),
    }
    plain = ReadSettings(
        scale=0.5, depth_scale=1000, turn=90, principal=(1.0, 2.0), gravity=(0, 0, -1)
    )
    assert ReadSettings(**of_numpy) == plain
    assert json.dumps(asdict(ReadSettings(**of_numpy)))
