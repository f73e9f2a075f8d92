"""transforms.json: axes, pixel centres, lenses, depth units, and every wrong thing json can say."""

import json
import logging
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import ExifTags, Image

from helpers import lenses
from tf_lab.data.readers import open_capture, transforms
from tf_lab.data.readers.source import SourceCapture
from tf_lab.data.reading import ReadSettings
from tf_lab.errors import TFLabError

SIZE = (40, 30)
CAMERA = {"fl_x": 38.0, "fl_y": 39.0, "cx": 20.5, "cy": 15.0, "w": 40, "h": 30}
K = np.array([[38.0, 0, 20.0], [0, 39.0, 14.5], [0, 0, 1]])  # pixel centres at integers
# At (1, 2, 3), looking along +y of a z-up world: right is +x, up +z, back -y.
MATRIX = [[1.0, 0, 0, 1], [0, 0, -1, 2], [0, 1, 0, 3], [0, 0, 0, 1]]
EXPECTED = [[1.0, 0, 0, 1], [0, 0, 1, 2], [0, -1, 0, 3], [0, 0, 0, 1]]  # down is -z, front +y

LEVEL = ReadSettings(gravity=(0, 0, -1))


def frame(i: int, **extra: Any) -> dict[str, Any]:
    return {"file_path": f"images/{i}.png", "transform_matrix": MATRIX, **extra}


def write(folder: Path, document: Any, images: int = 3) -> Path:
    (folder / "images").mkdir(exist_ok=True)
    for i in range(images):
        Image.new("RGB", SIZE, (i, 2 * i, 3 * i)).save(folder / "images" / f"{i}.png")
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., SourceCapture]:
    """Reads frames and what else is said of the camera."""

    def read(frames: list[Any], **settings: Any) -> SourceCapture:
        return transforms.read(write(tmp_path, {**settings, "frames": frames}))

    return read


Read = Callable[..., SourceCapture]


def test_axes_and_pixel_centres(read: Read) -> None:
    capture = read([frame(0)], **CAMERA)
    np.testing.assert_allclose(capture.world_T_cam[0], EXPECTED, atol=1e-15)
    np.testing.assert_allclose(capture.K[0], K, atol=1e-12)
    assert (capture.size, capture.frames, capture.down, capture.metric) == (SIZE, ["0"], None, True)


def test_the_folder_and_the_file_are_the_same_capture(tmp_path: Path) -> None:
    folder = write(tmp_path, {**CAMERA, "frames": [frame(0)]})
    a = open_capture(folder, ReadSettings(gravity=(0, 0, -1)))
    b = open_capture(folder / "transforms.json", ReadSettings(gravity=(0, 0, -1)))
    assert a.name == b.name == tmp_path.name
    np.testing.assert_array_equal(a.world_T_cam, b.world_T_cam)
    (folder / "transforms.json").rename(folder / "other.json")
    assert open_capture(folder / "other.json", LEVEL).frames == ["0"]
    with pytest.raises(TFLabError, match="3 images in images/, but no camera poses"):
        open_capture(folder)


def test_the_splits_are_one_capture(tmp_path: Path) -> None:
    splits = {"train": [0, 2], "val": [], "test": [1]}
    for split, images in splits.items():
        (tmp_path / split).mkdir()
        for i in images:
            Image.new("RGB", SIZE, (10 * i, 0, 0)).save(tmp_path / split / f"r_{i}.png")
        frames = [frame(0, file_path=f"./{split}/r_{i}", rotation=0.01) for i in images]
        document = {"camera_angle_x": 2 * math.atan(0.5), "frames": frames}
        if images:
            (tmp_path / f"transforms_{split}.json").write_text(json.dumps(document))
    capture = open_capture(tmp_path, LEVEL)
    assert capture.frames == ["r_0", "r_2", "r_1"]  # train, then test
    assert [capture.image(i)[0, 0, 0] for i in range(3)] == [0, 20, 10]
    np.testing.assert_allclose(capture.K[0], [[40, 0, 19.5], [0, 40, 14.5], [0, 0, 1]])
    assert (
        len(
            open_capture(
                tmp_path / "transforms_train.json", ReadSettings(gravity=(0, 0, -1))
            ).frames
        )
        == 2
    )
    (tmp_path / "transforms_train.json").write_text("{}")
    with pytest.raises(TFLabError, match=r"transforms_train\.json: no list of frames"):
        open_capture(tmp_path)
    write(tmp_path, {**CAMERA, "frames": [frame(0)]})
    assert open_capture(tmp_path, LEVEL).frames == ["0"]  # the whole goes first


def test_the_scale_of_all_rotations_is_taken_out(
    read: Read, caplog: pytest.LogCaptureFixture
) -> None:
    scaled = [[0.25 * value for value in row[:3]] + row[3:] for row in MATRIX[:3]]
    mirrored = [[-value for value in row[:3]] + row[3:] for row in scaled]
    frames = [frame(i, transform_matrix=[*scaled, MATRIX[3]]) for i in range(3)]
    with caplog.at_level(logging.WARNING):
        capture = read([*frames, frame(1, transform_matrix=mirrored), frame(1)], **CAMERA)
    assert "scaled by 0.25; the scale is taken out, positions stay" in caplog.text
    np.testing.assert_allclose(capture.world_T_cam, [EXPECTED] * 3, atol=1e-12)
    assert len(capture.skipped) == 2  # the mirrored, and the one of another scale
    assert all("not a rigid transform" in reason for reason in capture.skipped)


def test_three_rows_are_a_pose(read: Read) -> None:
    capture = read([frame(0, transform_matrix=MATRIX[:3])], **CAMERA)
    np.testing.assert_allclose(capture.world_T_cam[0], EXPECTED, atol=1e-15)


def test_the_frame_goes_before_the_whole(read: Read) -> None:
    frames = [frame(0), frame(1, fl_x=50.0, cx=18.5), frame(2)]
    capture = read(frames, **CAMERA)
    np.testing.assert_allclose(capture.K[[0, 2]], [K, K])
    np.testing.assert_allclose(capture.K[1], [[50, 0, 18], [0, 39, 14.5], [0, 0, 1]])
    alone = read([{**CAMERA, **f} for f in frames])
    np.testing.assert_array_equal(alone.K, capture.K)


def test_field_of_view_for_focal_length_and_size_of_the_images(read: Read) -> None:
    angle = 2 * math.atan(20 / 38)  # half of 40 pixels over 38
    middle = [[38.0, 0, 19.5], [0, 38.0, 14.5], [0, 0, 1]]
    np.testing.assert_allclose(read([frame(0)], camera_angle_x=angle).K[0], middle)
    both = read([frame(0)], camera_angle_x=angle, camera_angle_y=2 * math.atan(15 / 39))
    assert both.K[0, 1, 1] == pytest.approx(39)
    assert read([frame(0)], fl_x=30.0, camera_angle_x=angle).K[0, 0, 0] == 30
    assert read([frame(0)], fl_x=30.0).K[0, 1, 1] == 30


def test_the_principal_point_says_how_turned_pictures_are_meant(tmp_path: Path) -> None:
    """Where no size is stated: those of a phone held upright are stored lying."""
    document = {"fl_x": 39.0, "fl_y": 38.0, "cx": 15.0, "cy": 20.5}
    frames = [{**frame(0), "file_path": "images/0.jpg"}]
    folder = write(tmp_path, {**document, "frames": frames}, images=0)
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    Image.new("RGB", SIZE).save(folder / "images" / "0.jpg", exif=exif)
    capture = transforms.read(folder)
    assert capture.size == SIZE[::-1]
    assert capture.image(0).shape == (40, 30, 3)


def test_names_without_suffix_from_windows_and_of_other_folders(tmp_path: Path) -> None:
    folder = tmp_path / "jsons"
    folder.mkdir()
    (tmp_path / "train").mkdir()
    Image.new("RGB", SIZE).save(tmp_path / "train" / "r_10.png")
    Image.new("RGB", SIZE).save(tmp_path / "train" / "r.9.JPG", format="jpeg")
    Image.new("RGB", SIZE).save(tmp_path / "train" / "a.jpg")
    files = ["../train/r_10", "..\\train\\r.9", str(tmp_path / "train" / "a.jpg")]
    frames = [{"file_path": f, "transform_matrix": MATRIX} for f in files]
    capture = transforms.read(write(folder, {**CAMERA, "frames": frames}))
    assert sorted(capture.frames) == ["a", "r.9", "r_10"]
    assert capture.skipped == []
    assert capture.image(0).shape == (30, 40, 3)


def test_natural_order_and_names_that_meet(tmp_path: Path) -> None:
    files = ["b/10.png", "a/2.png", "b/9.png", "a/10.png"]
    for file in files:
        (tmp_path / file).parent.mkdir(exist_ok=True)
        Image.new("RGB", SIZE).save(tmp_path / file)
    frames = [{"file_path": f, "transform_matrix": MATRIX} for f in files]
    capture = transforms.read(write(tmp_path, {**CAMERA, "frames": frames}))
    assert capture.frames == ["a_2", "a_10", "b_9", "b_10"]


OPENCV = {"k1": -0.2, "k2": 0.05, "p1": 0.003, "p2": -0.002, "k3": 0.01}
FISHEYE = {"k1": 0.03, "k2": -0.01, "k3": 0.004, "k4": -0.001}
FISHEYE_LENS = lenses.fisheye(0.03, -0.01, 0.004, -0.001)


@pytest.mark.parametrize(
    ("settings", "lens"),
    [
        ({"camera_model": "OPENCV", **OPENCV}, lenses.perspective(**OPENCV)),
        (OPENCV, lenses.perspective(**OPENCV)),
        ({"camera_model": "PINHOLE"}, None),
        ({"camera_model": "OPENCV_FISHEYE", **FISHEYE}, FISHEYE_LENS),
        ({"is_fisheye": True, **FISHEYE}, FISHEYE_LENS),
        ({"camera_model": "OPENCV_FISHEYE"}, lenses.fisheye()),
    ],
)
def test_lenses_are_straightened(
    tmp_path: Path, settings: dict[str, Any], lens: lenses.Lens | None
) -> None:
    size = (120, 90)
    camera = {"fl_x": 110.0, "fl_y": 112.0, "cx": 61.0, "cy": 44.5, "w": 120, "h": 90}
    K = np.array([[110.0, 0, 60.5], [0, 112.0, 44.0], [0, 0, 1]])
    folder = write(tmp_path, {**camera, **settings, "frames": [frame(0)]})
    Image.fromarray(lenses.photograph(K, size, lens)).save(folder / "images" / "0.png")
    capture = transforms.read(folder)
    expected = lenses.colours(lenses.slopes_of(capture.K[0], size))
    assert np.abs(capture.image(0) - expected)[2:-2, 2:-2].max() < 2.5


NGP = ("depth_path", "integer_depth_scale")
NERFSTUDIO = ("depth_file_path", "depth_unit_scale_factor")


@pytest.mark.parametrize(
    ("keys", "unit", "metres"),
    [(NERFSTUDIO, None, 1.5), (NERFSTUDIO, 0.001, 1.5), (NERFSTUDIO, 0.0002, 0.3),
     (NGP, 0.0002, 0.3)],
)  # fmt: skip
def test_depth_and_its_unit(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    keys: tuple[str, str],
    unit: float | None,
    metres: float,
) -> None:
    said = {} if unit is None else {keys[1]: unit}
    frames = [frame(0, **{keys[0]: "depth/0.png"}), frame(1), frame(2, **{keys[0]: "no.png"})]
    folder = write(tmp_path, {**CAMERA, **said, "frames": frames})
    (folder / "depth").mkdir()
    raw = np.full((15, 20), 1500, np.uint16)  # of half the size
    raw[:5] = 0
    Image.fromarray(raw).save(folder / "depth" / "0.png")
    with caplog.at_level(logging.WARNING):
        capture = transforms.read(folder)
    depth = capture.depth(0)
    assert depth is not None
    np.testing.assert_allclose(depth[:10], 0)
    np.testing.assert_allclose(depth[10:], metres)
    assert capture.depth(1) is capture.depth(2) is None
    assert "1 of its depth files are missing" in caplog.text
    assert "no unit of length" not in caplog.text


def test_depth_of_unknown_unit_is_left_out(read: Read, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        capture = read([frame(0, depth_path="images/1.png")], **CAMERA)
    assert capture.depth(0) is None
    assert "depth_path without integer_depth_scale is left out" in caplog.text


def test_without_depth_the_unit_is_doubted(read: Read, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        read([frame(0)], **CAMERA)
    assert "no unit of length" in caplog.text


def test_smaller_images_of_the_same_shape(tmp_path: Path) -> None:
    large = {"fl_x": 76.0, "fl_y": 78.0, "cx": 41.0, "cy": 30.0, "w": 80, "h": 60}
    capture = transforms.read(write(tmp_path, {**large, "frames": [frame(0)]}))
    np.testing.assert_allclose(capture.K[0], K)
    assert capture.image(0).shape == (30, 40, 3)
    folder = write(tmp_path, {**CAMERA, "h": 40, "frames": [frame(0)]})
    with pytest.raises(TFLabError, match=r"images are 40x30, their camera 40x40"):
        transforms.read(folder)


def test_frames_without_image_or_pose_are_skipped(read: Read) -> None:
    lost = [[math.nan] * 4] * 4
    bad = [
        frame(7), frame(1, transform_matrix=lost), frame(2, transform_matrix=[[1, 2], [3]]),
        {"transform_matrix": MATRIX}, "text", None, 3, {"file_path": 5}, {"file_path": ""},
        {"file_path": "images/\0.png"}, {"file_path": "x" * 5000}, {"file_path": "images"},
        frame(0, fl_x="wide"), frame(0, w=-3), frame(0, h=10**30),
        frame(0, camera_model=["OPENCV"]), frame(0, camera_model="EQUIRECTANGULAR"),
        frame(0, k4=0.1), frame(0, k1=True), frame(0, transform_matrix={"a": 1}),
        frame(0, transform_matrix=None), {"file_path": "images/0.png"},
    ]  # fmt: skip
    capture = read([*bad, frame(0)], **CAMERA)
    assert capture.frames == ["0"]
    reasons = "\n".join(capture.skipped)
    assert len(capture.skipped) == len(bad)
    for reason in ("no image 'images/7.png'", "NaN or infinity", "no file_path",
                   "not 16 or 12 numbers", "'wide', not a number", "'EQUIRECTANGULAR' is unknown",
                   "k4 is for fisheye", "size of -3x30 is impossible"):  # fmt: skip
        assert reason in reasons


HUGE = '{"frames": 1' + "0" * 9999 + "}"


@pytest.mark.parametrize(
    "text",
    ["", "[]", "null", "{", '{"frames": {}}', '{"frames": []}', "[" * 100000, HUGE],
    ids=range(8),
)
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(
        TFLabError, match=r"transforms\.json: (damaged: not JSON|no json object|no list of)"
    ):
        open_capture(tmp_path)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match=r"transforms\.json: missing"):
        open_capture(tmp_path, ReadSettings(format="transforms"))


@pytest.mark.parametrize("value", [0, -1, "1mm", None, math.inf, [1]])
def test_a_depth_unit_that_is_none(read: Read, value: Any) -> None:
    with pytest.raises(TFLabError, match="depth_unit_scale_factor"):
        read([frame(0, depth_file_path="0.png")], **CAMERA, depth_unit_scale_factor=value)
    with pytest.raises(TFLabError, match="integer_depth_scale"):
        read([frame(0, depth_path="0.png")], **CAMERA, integer_depth_scale=value)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({}, "fl_x is 'None', not a number"),
        ({"camera_angle_x": 0}, "camera_angle_x is 0"),
        ({"camera_angle_x": 4.0}, "camera_angle_x is 4"),
        ({**CAMERA, "fl_x": -1}, "must be positive"),
        ({**CAMERA, "fl_y": math.inf}, "fl_y is 'inf'"),
        ({**CAMERA, "k1": 1e9}, "makes no sense"),
        ({**CAMERA, "w": 10**9}, "impossible"),
    ],
)
def test_a_camera_that_is_none(read: Read, settings: dict[str, Any], reason: str) -> None:
    with pytest.raises(TFLabError, match=reason):
        read([frame(0), frame(1)], **settings)
