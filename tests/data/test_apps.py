"""Recordings of iPhone apps: axes, sizes, which depth is trusted, and what is wrong with some."""

import json
import logging
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from helpers.layouts import (
    polycam as polycam_layout,
    record3d as record3d_layout,
    room_frames,
    scanner_app as scanner_layout,
    stray_scanner as stray_layout,
)
from tf_lab.data.readers import (
    detect_format,
    open_capture,
    polycam,
    record3d,
    scanner_app,
    stray_scanner as stray,
)
from tf_lab.data.reading import ReadSettings
from tf_lab.errors import TFLabError

# A camera at (1, 2, 3) of ARKit's y-up world, not turned: right is +x, down -y, and it looks to -z.
AHEAD = [[1, 0, 0, 1], [0, -1, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]
OPENGL = [[1.0, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]  # the same by ARKit's axes
SIZE = (40, 30)
FRAMES = room_frames()[:4]


def small_depth(folder: Path, name: str, levels: list[list[int]]) -> None:
    """Depth of 2x2 readings, 1 to 4 m, and how far to trust them."""
    (folder / "depth").mkdir(exist_ok=True, parents=True)
    (folder / "confidence").mkdir(exist_ok=True)
    depth = np.array([[1000, 2000], [3000, 4000]], np.uint16)
    Image.fromarray(depth).save(folder / "depth" / f"{name}.png")
    Image.fromarray(np.array(levels, np.uint8)).save(folder / "confidence" / f"{name}.png")


def corners(depth: np.ndarray | None) -> list[float]:
    assert depth is not None
    return [float(depth[y, x]) for y in (0, -1) for x in (0, -1)]


def edit(file: Path, change: Callable[[dict[str, Any]], object]) -> None:
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))


@pytest.fixture
def stray_folder(tmp_path: Path) -> Path:
    return stray_layout.write(tmp_path / "71de12f9", FRAMES)


HEADER = "timestamp, frame, x, y, z, qx, qy, qz, qw"


def test_stray_axes_and_further_columns(stray_folder: Path) -> None:
    lines = [f"{HEADER}, fx", "1.5, 000002, 1, 2, 3, 1, 0, 0, 0, 99", "", "1.6,1,0,0,0,0,0,0,2,99"]
    (stray_folder / "odometry.csv").write_text("\n".join(lines) + "\n")
    capture = stray.read(stray_folder)
    assert capture.frames == ["000001", "000002"]
    np.testing.assert_allclose(capture.world_T_cam[1], AHEAD, atol=1e-12)
    np.testing.assert_allclose(capture.world_T_cam[0], np.eye(4))
    for i, index in enumerate((1, 2)):  # images and depth by the number of the frame
        np.testing.assert_array_equal(capture.image(i), FRAMES[index].image)
        np.testing.assert_allclose(capture.depth(i), FRAMES[index].depth, atol=1e-3)
    assert capture.down == (0, -1, 0)


def test_stray_cameras_of_frames(stray_folder: Path) -> None:
    """Newer versions write them, for phones refocus."""
    (fx, _, cx), (_, fy, cy), _ = FRAMES[0].K
    wrong = "1.7, 3, 0, 0, 0, 0, 0, 0, 1, nan, 1, 1, 1"
    lines = [
        f"{HEADER}, fx, fy, cx, cy, distortion_center_x",
        *(f"1.{i}, {i}, 0, 0, 0, 0, 0, 0, 1, {fx + i}, {fy - i}, {cx + 0.5}, {cy + 0.5}, 0"
          for i in range(3)),
        wrong,
    ]  # fmt: skip
    (stray_folder / "odometry.csv").write_text("\n".join(lines) + "\n")
    capture = stray.read(stray_folder)
    np.testing.assert_allclose(capture.K[:, 0, 0], [fx, fx + 1, fx + 2])
    np.testing.assert_allclose(capture.K[:, 1, 1], [fy, fy - 1, fy - 2])
    np.testing.assert_allclose(capture.K[0, :2, 2], [cx, cy])
    assert len(capture.skipped) == 1
    assert capture.skipped[0].startswith(f"line 5, {wrong[:30]!r}")


def test_stray_depth_where_it_is_confident(stray_folder: Path) -> None:
    small_depth(stray_folder, "000000", [[0, 1], [2, 0]])
    small_depth(stray_folder, "000001", [[0, 0], [0, 0]])
    (stray_folder / "confidence" / "000001.png").unlink()
    (stray_folder / "depth" / "000002.png").unlink()
    np.save(stray_folder / "depth" / "000002.npy", np.full((2, 2), 1500, np.uint16))
    (stray_folder / "depth" / "000003.png").unlink()
    capture = stray.read(stray_folder)
    assert corners(capture.depth(0)) == [0, 2, 3, 0]  # medium and high stay
    doubled = open_capture(stray_folder, ReadSettings(depth_scale=500.0))
    assert corners(doubled.depth(0)) == [0, 4, 6, 0]
    assert corners(capture.depth(1)) == [1, 2, 3, 4]  # nothing says how far to trust it
    with pytest.raises(TFLabError, match=r"000002\.png: is of another size than .*000002\.npy"):
        capture.depth(2)  # the map that `write` has left there
    assert capture.depth(3) is None
    (stray_folder / "confidence" / "000002.png").write_bytes(b"no image")
    with pytest.raises(TFLabError, match=r"confidence/000002\.png: cannot be read"):
        capture.depth(2)
    shutil.rmtree(stray_folder / "confidence")
    assert corners(stray.read(stray_folder).depth(2)) == [1.5] * 4


def test_stray_lines_that_are_no_poses(stray_folder: Path) -> None:
    bad = ["x", '1, 8, "', "1, 3, 0, 0, 0, 0, 0, 0, 0", "1, one, 0, 0, 0, 0, 0, 0, 1",
           "1, nan, 0, 0, 0, 0, 0, 0, 1", "1, 2, nan, 0, 0, 0, 0, 0, 1",
           "1, 7, 0, 0, 0, 0, 0, 0, 1"]  # fmt: skip
    lines = [HEADER, "1, 0, 0, 0, 0, 0, 0, 0, 1", *bad]
    (stray_folder / "odometry.csv").write_text("\n".join(lines))
    capture = stray.read(stray_folder)
    assert capture.frames == ["000000"]
    assert len(capture.skipped) == len(bad)
    assert capture.skipped[-1] == "000007: not one of the 4 images"


def test_stray_parts_that_are_missing_or_of_others(stray_folder: Path) -> None:
    (stray_folder / "odometry.csv").write_text("1, 0, 0, 0, 0, 0, 0, 0, 1\n")
    with pytest.raises(TFLabError, match=r"odometry\.csv: no column frame; .*names the columns"):
        open_capture(stray_folder)
    width, height = FRAMES[0].image.shape[1::-1]
    (stray_folder / "camera_matrix.csv").write_text(f"60,0,{height / 2}\n0,60,{height - 1}\n0,0,1")
    with pytest.raises(TFLabError, match=rf"camera_matrix\.csv: .*not near the middle of {width}"):
        open_capture(stray_folder)
    (stray_folder / "rgb.mp4").unlink()
    with pytest.raises(TFLabError, match=r"rgb\.mp4: no such video"):
        open_capture(stray_folder)


def write_scan(folder: Path, number: int, **changes: Any) -> None:
    """A frame of 3D Scanner App at (1, 2, 3), not turned."""
    document = {
        "cameraPoseARFrame": np.ravel(OPENGL).tolist(),
        "intrinsics": [35, 0, 20.5, 0, 36, 15, 0, 0, 1],
        **changes,
    }
    (folder / f"frame_{number:05d}.json").write_text(json.dumps(document))
    Image.new("RGB", SIZE, (number, 0, 0)).save(folder / f"frame_{number:05d}.jpg", quality=100)


def test_scanner_app(tmp_path: Path) -> None:
    for number in (0, 4):
        write_scan(tmp_path, number)
    write_scan(tmp_path, 2)
    (tmp_path / "frame_00002.jpg").unlink()  # as of most frames
    Image.new("RGB", SIZE).save(tmp_path / "texture.jpg")
    assert detect_format(tmp_path) == ["scanner_app"]
    capture = scanner_app.read(tmp_path)
    assert capture.frames == ["frame_00000", "frame_00004"]
    assert capture.skipped == []
    np.testing.assert_allclose(capture.world_T_cam, [AHEAD] * 2)
    np.testing.assert_allclose(capture.K[0], [[35, 0, 20], [0, 36, 14.5], [0, 0, 1]])
    assert capture.down == (0, -1, 0)
    assert capture.depth(0) is None


def test_scanner_app_depth_where_it_is_confident(tmp_path: Path) -> None:
    write_scan(tmp_path, 0)
    small_depth(tmp_path, "00000", [[2, 1], [0, 2]])
    for folder, name in (("depth", "depth"), ("confidence", "conf")):
        (tmp_path / folder / "00000.png").rename(tmp_path / f"{name}_00000.png")
    assert corners(scanner_app.read(tmp_path).depth(0)) == [1, 2, 0, 4]


def test_scanner_app_frames_that_are_wrong(tmp_path: Path) -> None:
    write_scan(tmp_path, 0)
    wrong: list[dict[str, Any]] = [
        {"intrinsics": None}, {"intrinsics": [35, 0, 15, 0, 36, 20.5, 0, 0, 1]},
        {"intrinsics": ["a"] * 9}, {"intrinsics": [0] * 9}, {"cameraPoseARFrame": [[1, 0]] * 3},
        {"cameraPoseARFrame": [float("nan")] * 16}, {"cameraPoseARFrame": [0] * 16},
    ]  # fmt: skip
    for i, changes in enumerate(wrong, start=1):
        write_scan(tmp_path, i, **changes)
    write_scan(tmp_path, 8)
    (tmp_path / "frame_00008.json").write_text("[]")
    capture = scanner_app.read(tmp_path)
    assert capture.frames == ["frame_00000"]
    assert len(capture.skipped) == len(wrong) + 1
    reasons = "\n".join(capture.skipped)
    for reason in ("its intrinsics is not 9 numbers", "not near the middle of 40x30",
                   "PoseARFrame is not 16 numbers", "frame lost", "no json object"):  # fmt: skip
        assert reason in reasons


@pytest.fixture
def polycam_folder(tmp_path: Path) -> Path:
    return polycam_layout.write(tmp_path / "capture", FRAMES)


def test_polycam_goes_by_the_corrected_cameras(polycam_folder: Path) -> None:
    assert detect_format(polycam_folder) == ["polycam"]
    corrected = polycam.read(polycam_folder)
    assert corrected.down == (0, -1, 0)
    keyframes = polycam_folder / "keyframes"
    shutil.rmtree(keyframes / "images")
    (keyframes / "corrected_images").rename(keyframes / "images")
    recorded = polycam.read(polycam_folder)  # a capture too large for corrections
    np.testing.assert_allclose(recorded.world_T_cam[:, 0, 3], 9)
    np.testing.assert_array_equal(recorded.K, corrected.K)
    np.testing.assert_array_equal(recorded.image(1), FRAMES[1].image)


def test_polycam_axes_sizes_and_confidence(polycam_folder: Path) -> None:
    keyframes = polycam_folder / "keyframes"
    cameras = sorted((keyframes / "corrected_cameras").iterdir())
    values = {f"t_{i}{j}": OPENGL[i][j] for i in range(3) for j in range(4)}
    large = {"width": 192, "height": 144, "fx": 160.0, "fy": 161.0, "cx": 98.0, "cy": 71.0}
    edit(cameras[0], lambda document: document.update(values | large))
    for camera in cameras[1:]:
        camera.unlink()
    small_depth(keyframes, cameras[0].stem, [[0, 54], [127, 255]])
    capture = polycam.read(polycam_folder)
    assert len(capture.skipped) == 3
    np.testing.assert_allclose(capture.world_T_cam[0], AHEAD)
    # of images made half as large
    np.testing.assert_allclose(capture.K[0], [[80, 0, 48.5], [0, 80.5, 35], [0, 0, 1]])
    assert corners(capture.depth(0)) == [0, 2, 3, 4]


@pytest.mark.parametrize("key", ["fx", "width", "t_23"])
def test_polycam_frames_that_are_wrong(polycam_folder: Path, key: str) -> None:
    cameras = sorted((polycam_folder / "keyframes" / "corrected_cameras").iterdir())
    edit(cameras[1], lambda document: document.pop(key))
    edit(cameras[2], lambda document: document.update({key: "x"}))
    capture = polycam.read(polycam_folder)
    assert len(capture) == 2
    assert [f"{key} is" in reason for reason in capture.skipped] == [True, True]


@pytest.fixture
def record3d_folder(tmp_path: Path) -> Path:
    return record3d_layout.write(tmp_path / "EXR_RGBD", FRAMES)


def test_record3d_cameras(record3d_folder: Path) -> None:
    whole = record3d.read(record3d_folder)
    assert whole.down is None  # its world is that of the first camera
    poses = [[0, 0, 0, 1, 1, 2, 3]] * 3
    coefficients = [[60 + i, 61, 47.5, 36.5] for i in range(4)]
    changes = {"poses": poses, "perFrameIntrinsicCoeffs": coefficients}
    edit(record3d_folder / "metadata.json", lambda document: document.update(changes))
    capture = record3d.read(record3d_folder)
    np.testing.assert_allclose(capture.world_T_cam[0], AHEAD)
    np.testing.assert_allclose(capture.K[:, 0, 0], [60, 61, 62])  # they go first
    np.testing.assert_allclose(capture.K[0, :2, 2], [47, 36])
    assert capture.skipped == ["3: poses has nothing on it"]


def test_record3d_unzipped(record3d_folder: Path) -> None:
    expected = record3d.read(record3d_folder)
    (record3d_folder / "metadata.json").rename(record3d_folder / "metadata")
    (record3d_folder / "rgb").rename(record3d_folder / "rgbd")
    for i in range(4):
        file = record3d_folder / "depth" / f"{i}.bin"
        file.rename(record3d_folder / "rgbd" / f"{i}.depth")
    assert detect_format(record3d_folder) == ["record3d"]
    capture = record3d.read(record3d_folder)
    np.testing.assert_array_equal(capture.world_T_cam, expected.world_T_cam)
    for i in range(4):
        np.testing.assert_array_equal(capture.image(i), FRAMES[i].image)
        np.testing.assert_array_equal(capture.depth(i), FRAMES[i].depth)


def test_record3d_depth_beside_its_pictures_is_no_picture(record3d_folder: Path) -> None:
    (record3d_folder / "metadata.json").rename(record3d_folder / "metadata")
    (record3d_folder / "rgb").rename(record3d_folder / "rgbd")
    for i, frame in enumerate(FRAMES):
        picture = record3d_folder / "rgbd" / f"{i}.png"
        Image.open(picture).save(picture.with_suffix(".jpg"), quality=95)
        Image.fromarray(np.round(frame.depth * 1000).astype(np.uint16)).save(picture)
    capture = record3d.read(record3d_folder)
    assert capture.frames == [str(i) for i in range(len(FRAMES))]
    for i, frame in enumerate(FRAMES):
        np.testing.assert_allclose(capture.depth(i), frame.depth, atol=0.0006)
        assert np.abs(capture.image(i).astype(int) - frame.image).mean() < 5


@pytest.mark.parametrize("suffix", [".exr", ".depth"])
def test_record3d_depth_that_cannot_be_read(
    record3d_folder: Path, caplog: pytest.LogCaptureFixture, suffix: str
) -> None:
    for file in (record3d_folder / "depth").iterdir():
        file.write_bytes(b"bvx2 compressed")
        file.rename(file.with_suffix(suffix))
    with caplog.at_level(logging.WARNING):
        capture = record3d.read(record3d_folder)
    assert all(capture.depth(i) is None for i in range(4))
    assert f"depth is left out, for files like 0{suffix} cannot be read" in caplog.text
    for i, frame in enumerate(FRAMES):  # converted
        np.save(record3d_folder / "depth" / f"{i}.npy", frame.depth)
    caplog.clear()
    np.testing.assert_array_equal(record3d.read(record3d_folder).depth(2), FRAMES[2].depth)
    assert "left out" not in caplog.text


@pytest.mark.parametrize("changes", [{"K": [1]}, {"w": "wide"}, {"poses": None}, {"poses": [[1]]}])
def test_record3d_metadata_that_is_wrong(record3d_folder: Path, changes: dict[str, Any]) -> None:
    edit(record3d_folder / "metadata.json", lambda document: document.update(changes))
    with pytest.raises(
        TFLabError, match=rf"no usable frame.* the first: 0: .*{next(iter(changes))}"
    ):
        open_capture(record3d_folder)


def test_quaternions_of_another_order(stray_folder: Path, record3d_folder: Path) -> None:
    """What the settings mend is mended by each layout's own convention."""
    right = [open_capture(folder).world_T_cam for folder in (stray_folder, record3d_folder)]
    header, *lines = (stray_folder / "odometry.csv").read_text().splitlines()
    rows = [line.split(", ") for line in lines]
    swapped = [", ".join([*row[:5], row[8], *row[5:8]]) for row in rows]
    (stray_folder / "odometry.csv").write_text("\n".join([header, *swapped]))
    edit(
        record3d_folder / "metadata.json",
        lambda d: d.update(poses=[[p[3], *p[:3], *p[4:]] for p in d["poses"]]),
    )
    settings = ReadSettings(quaternions="wxyz")
    for folder, expected in zip((stray_folder, record3d_folder), right, strict=True):
        mended = open_capture(folder, settings).world_T_cam
        np.testing.assert_allclose(mended, expected, atol=1e-6)


def test_opencv_axes_in_a_layout_of_opengl(tmp_path: Path, polycam_folder: Path) -> None:
    right = open_capture(polycam_folder).world_T_cam
    for camera in (polycam_folder / "keyframes" / "corrected_cameras").iterdir():
        edit(
            camera,
            lambda d: d.update({k: -v for k, v in d.items() if k[-1] in "12" and k[0] == "t"}),
        )
    mended = open_capture(polycam_folder, ReadSettings(axes="opencv")).world_T_cam
    np.testing.assert_allclose(mended, right, atol=1e-9)


def test_no_app_is_taken_for_another(tmp_path: Path) -> None:
    for layout in (stray_layout, scanner_layout, polycam_layout, record3d_layout):
        name = layout.__name__.split(".")[-1]
        assert detect_format(layout.write(tmp_path / name, FRAMES)) == [name]
