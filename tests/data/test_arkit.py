"""ARKit recordings of ios_logger: axes, timestamps, intrinsics, and which image is which."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.layouts.video import write_video
from tf_lab.data.readers import arkit, open_capture
from tf_lab.data.reading import ReadSettings
from tf_lab.errors import TFLabError

SIZE = (48, 36)
COUNT = 6
INTRINSICS = "40,41,24.25,18.5"
K = np.array([[40.0, 0, 23.75], [0, 41.0, 18.0], [0, 0, 1]])  # pixel centres at integers


def image(i: int) -> np.ndarray:
    return np.full((SIZE[1], SIZE[0], 3), (40 * i, 10, 200 - 30 * i), np.uint8)


@pytest.fixture
def recorded(tmp_path: Path) -> Callable[..., Path]:
    """Writes a recording of frames at 100, 100.1, ... s; gives the folder."""

    def write(frames: list[str] | None = None, poses: list[str] | None = None) -> Path:
        write_video(tmp_path / "a.mov", [image(i) for i in range(COUNT)])
        (tmp_path / "a.mov").rename(tmp_path / "Frames.m4v")
        lines = [f"{100 + i / 10:f},{i},{INTRINSICS}" for i in range(COUNT)]
        (tmp_path / "Frames.txt").write_text("\r\n".join(frames or lines) + "\r\n")
        lines = [f"{100 + i / 10:f},{i},0,0,1,0,0,0" for i in range(COUNT)]
        (tmp_path / "ARposes.txt").write_text("\r\n".join(poses or lines) + "\r\n")
        return tmp_path

    return write


Record = Callable[..., Path]


def test_axes(recorded: Record) -> None:
    """Two cameras, by hand: the world's y is up, the camera's z is back."""
    half = 0.5**0.5
    poses = ["100,1,2,3,1,0,0,0", f"100.1,1,2,3,{half},0,{half},0"]
    poses += [f"{100 + i / 10},0,0,0,1,0,0,0" for i in range(2, COUNT)]
    capture = arkit.read(recorded(poses=poses))
    # not turned: right is +x, down is -y, and it looks along -z
    np.testing.assert_allclose(
        capture.world_T_cam[0], [[1, 0, 0, 1], [0, -1, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]
    )
    # turned to the left by 90 degrees (about +y): right is -z, and it looks along -x
    np.testing.assert_allclose(
        capture.world_T_cam[1],
        [[0, 0, -1, 1], [0, -1, 0, 2], [-1, 0, 0, 3], [0, 0, 0, 1]],
        atol=1e-12,
    )
    # z-up: ARKit's y is up, its -z is forward
    upright = open_capture(capture_folder := recorded(poses=poses))
    np.testing.assert_allclose(upright.world_T_cam[0, :3, 2], [0, 1, 0], atol=1e-12)  # looks
    np.testing.assert_allclose(upright.world_T_cam[0, :3, 1], [0, 0, -1], atol=1e-12)  # down
    np.testing.assert_allclose(upright.world_T_cam[0, :3, 3], [1, -3, 2], atol=1e-12)
    assert upright.name == capture_folder.name


def test_images_and_intrinsics_of_every_frame(recorded: Record) -> None:
    lines = [f"{100 + i / 10:f},{i},{40 + i},{41 + i},24.25,{18.5 + i / 4}" for i in range(COUNT)]
    capture = arkit.read(recorded(lines))
    assert (capture.size, capture.frames[0], capture.metric) == (SIZE, "000000", True)
    change = np.array([[1, 0, 0], [0, 1, 0.25], [0, 0, 0]])
    for i in range(COUNT):
        np.testing.assert_allclose(capture.K[i], K + i * change)
        np.testing.assert_array_equal(capture.image(i), image(i))
        assert capture.depth(i) is None


def test_dropped_frames_and_comments(recorded: Record) -> None:
    lines = ["# time,frame,fx,fy,cx,cy", ""]
    lines += [f"{100 + i / 10:f},{i},{INTRINSICS}" for i in (0, 3, 5)]
    capture = arkit.read(recorded(lines))
    assert capture.frames == ["000000", "000003", "000005"]
    np.testing.assert_array_equal(capture.image(1), image(3))
    np.testing.assert_array_equal(capture.world_T_cam[:, 0, 3], [0, 3, 5])


def test_the_nearest_pose_within_a_frame(recorded: Record) -> None:
    offsets = [0.012, -0.02, 0.0201, -0.0249, 0.0, 0.005]
    poses = [f"{100 + i / 10 + o:f},{i},0,0,1,0,0,0" for i, o in enumerate(offsets)]
    poses.append(f"{100 - 0.011:f},50,0,0,1,0,0,0")  # nearer to frame 0, and out of order
    capture = arkit.read(recorded(poses=poses))
    np.testing.assert_array_equal(capture.world_T_cam[:, 0, 3], [50, 1, 4, 5])
    assert capture.skipped == [f"frame {i}: no pose within 0.02 s" for i in (2, 3)]


def test_frames_that_cannot_be_used_are_skipped(recorded: Record) -> None:
    frames = [f"{100 + i / 10:f},{i},{INTRINSICS}" for i in range(COUNT)]
    frames[1] = f"100.1,17,{INTRINSICS}"
    frames[2] = f"100.2,0,{INTRINSICS}"
    frames[3] = "100.3,3,-40,41,24,18"
    poses = [f"{100 + i / 10:f},{i},0,0,1,0,0,0" for i in range(COUNT)]
    poses[4] = "100.4,0,0,0,0,0,0,0"
    poses[5] = "100.5,0,0,nan,1,0,0,0"
    capture = arkit.read(recorded(frames, poses))
    assert capture.frames == ["000000"]
    reasons = [reason.partition(": ")[2] for reason in capture.skipped]
    for reason, expected in zip(
        reasons, ["not one of the 6", "a second time", "positive", "zeros", "NaN"], strict=True
    ):
        assert expected in reason


def test_images_in_place_of_the_video(recorded: Record) -> None:
    folder = recorded()
    (folder / "images").mkdir()
    for i in range(COUNT):
        Image.fromarray(image(i)[:, ::-1] // 2).save(folder / "images" / f"{i + 9}.png")
    np.testing.assert_array_equal(arkit.read(folder).image(2), image(2))  # the video goes first
    (folder / "Frames.m4v").unlink()
    capture = open_capture(folder)
    assert capture.frames[2] == "000002"
    np.testing.assert_array_equal(capture.image(2), image(2) // 2)
    (folder / "images" / "9.png").unlink()
    with pytest.raises(TFLabError, match=r"images/ has 5 images for the 6 lines of Frames\.txt"):
        open_capture(folder)


@pytest.mark.parametrize("intrinsics", ["40,41,18.5,24.25", "160,164,97,74", "20,20.5,12,9"])
def test_intrinsics_of_other_images(recorded: Record, intrinsics: str) -> None:
    """Of portrait ones, of larger ones, of smaller ones."""
    frames = [f"{100 + i / 10:f},{i},{intrinsics}" for i in range(COUNT)]
    with pytest.raises(TFLabError, match=r"not near the middle|outside"):
        arkit.read(recorded(frames))


@pytest.mark.parametrize(
    ("frames", "poses", "message"),
    [
        (["100,0"], None, r"Frames\.txt, line 1: '100,0'; .*timestamp,frame,fx,fy,cx,cy"),
        (["x,0,1,1,1,1"], None, r"Frames\.txt, line 1"),
        (["nan,0,1,1,1,1"], None, r"Frames\.txt, line 1"),
        (None, ["100,0,0,0,1,0,0"], r"ARposes\.txt, line 1.*timestamp,tx,ty,tz,qw,qx,qy,qz"),
        (None, ["# nothing"], "no usable frame.*no pose within"),
        (["# nothing"], None, "no usable frame"),
        ([f"100,zero,{INTRINSICS}"], None, "no usable frame.*invalid literal"),
        ([f"100,0,{INTRINSICS},9"], None, "no usable frame"),
    ],
)
def test_damaged_lists(
    recorded: Record, frames: list[str] | None, poses: list[str] | None, message: str
) -> None:
    with pytest.raises(TFLabError, match=message):
        arkit.read(recorded(frames, poses))


def test_missing_parts(recorded: Record) -> None:
    folder = recorded()
    assert arkit.detect(folder)
    (folder / "Frames.m4v").unlink()
    with pytest.raises(TFLabError, match=r"no Frames\.m4v, and images/ has 0 images"):
        open_capture(folder)
    (folder / "ARposes.txt").unlink()
    assert not arkit.detect(folder)
    with pytest.raises(TFLabError, match=r"ARposes\.txt: missing"):
        open_capture(folder, ReadSettings(format="arkit"))
