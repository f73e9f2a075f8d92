"""What the readers share: poses of quaternions, orders and names of files, sizes."""

from pathlib import Path, PurePosixPath

import numpy as np
import pytest
from PIL import Image

from tf_lab.data.lens import Camera
from tf_lab.data.readers.images import at_file_size, frame_names, is_file, natural_order
from tf_lab.data.readers.parsing import opencv_of_opengl, pose_of_quaternion
from tf_lab.errors import TFLabError


@pytest.mark.parametrize("length", [1.0, 1e-9, 1e300, -5.0])
def test_a_quarter_turn_about_z(length: float) -> None:
    half = 0.5**0.5 * length
    pose = pose_of_quaternion((half, 0, 0, half), (1, 2, 3))
    np.testing.assert_allclose(
        pose, [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-12
    )


@pytest.mark.parametrize(
    ("quaternion", "translation"),
    [
        ((0, 0, 0, 0), (0, 0, 0)),
        ((float("nan"), 0, 0, 1), (0, 0, 0)),
        ((float("inf"), 0, 0, 1), (0, 0, 0)),
        ((1, 0, 0, 0), (0, float("-inf"), 0)),
    ],
)
def test_no_pose(quaternion: tuple[float, ...], translation: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"zeros|NaN or infinity"):
        pose_of_quaternion(quaternion, translation)


def test_camera_axes_of_opengl() -> None:
    pose = pose_of_quaternion((0.9, 0.1, -0.3, 0.2), (1, 2, 3))
    turned = opencv_of_opengl(pose)
    np.testing.assert_array_equal(turned[:, [0, 3]], pose[:, [0, 3]])
    np.testing.assert_array_equal(turned[:3, 1:3], -pose[:3, 1:3])
    np.testing.assert_array_equal(opencv_of_opengl(turned), pose)


def test_natural_order() -> None:
    names = ["a/2.png", "a/10.png", "a10/1.png", "b/img.png", "b/img2.jpg", "b/img002b.png",
             "b/img10.png", "b/" + "9" * 20 + ".png", "b/1" + "0" * 5000 + ".png"]  # fmt: skip
    expected = [*names[:3], *names[7:], *names[3:7]]  # digits go before letters
    shuffled = np.random.default_rng(0).permutation(names).tolist()
    assert [str(p) for p in sorted(map(PurePosixPath, shuffled), key=natural_order)] == expected


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (["x/1.png", "x/2.png"], ["1", "2"]),
        (["x/1.png", "y/1.png"], ["x_1", "y_1"]),
        (["../x/1.png", "x/1.png"], ["0_1", "1_1"]),
        (["x/1.png", "x/1.jpg", "x_1.png"], ["0_1", "1_1", "2_x_1"]),
    ],
)
def test_names_of_frames(files: list[str], names: list[str]) -> None:
    assert frame_names([PurePosixPath(file) for file in files]) == names


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000, "\ud800", "", "."])
def test_impossible_files_are_not_there(tmp_path: Path, name: str) -> None:
    assert not is_file(tmp_path / name)


def test_cameras_follow_the_size_of_the_files(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("a.png", "b.png", "c.png")]
    files[0].write_bytes(b"damaged")
    Image.new("RGB", (8, 6)).save(files[1])
    Image.new("RGB", (20, 30)).save(files[2])
    large, other = Camera((32, 24), 30, 30, 15.5, 11.5), Camera((20, 30), 30, 30, 10, 10)
    found = at_file_size([large, large, other], files)
    assert found == [Camera((8, 6), 7.5, 7.5, 3.5, 2.5)] * 2 + [other]
    with pytest.raises(TFLabError, match=r"images are 8x6, their camera 20x30"):
        at_file_size([other], files[1:2])
    with pytest.raises(TFLabError, match="not one of the colour images"):
        at_file_size([other], files[:1])
    assert at_file_size([], []) == []
