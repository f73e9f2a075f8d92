"""Videos with poses: the right frame at every number, in the right colours; and damage."""

import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.layouts.video import held_upright, write_video
from tf_lab.data.readers import open_capture, video
from tf_lab.data.readers.frames_of_video import Video
from tf_lab.data.reading import ReadSettings
from tf_lab.errors import TFLabError

SIZE = (48, 32)
COUNT = 40
K = "40 0 23.5\n0 41 15.5\n0 0 1\n"


def frame(i: int) -> np.ndarray:
    """Frame i: blocks that spell its number in binary, on a red left and a green right half."""
    image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    image[:16, :24, 0] = image[:16, 24:, 1] = 200
    for bit in range(6):
        image[16:, bit * 8 : bit * 8 + 8] = 220 * (i >> bit & 1)
    return image


def number_in(image: np.ndarray) -> int:
    assert image.shape == (SIZE[1], SIZE[0], 3)
    assert image[4:12, 4:20].mean((0, 1)) == pytest.approx([200, 0, 0], abs=25)  # RGB
    assert image[4:12, 28:44].mean((0, 1)) == pytest.approx([0, 200, 0], abs=25)
    return sum(int(image[20:28, bit * 8 + 2 : bit * 8 + 6].mean() > 110) << bit for bit in range(6))


def frames(count: int = COUNT) -> list[np.ndarray]:
    return [frame(i) for i in range(count)]


@pytest.fixture(scope="module")
def coded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The frames as videos whose pictures depend on each other, or not; by their suffix."""
    codecs = {"mp4": "mp4v", "mov": "png ", "avi": "MJPG", "mkv": "mp4v", "webm": "VP80"}
    folder = tmp_path_factory.mktemp("videos")
    for suffix, codec in codecs.items():
        write_video(folder / f"a.{suffix}", frames(), codec)
    return {suffix: (folder / f"a.{suffix}").read_bytes() for suffix in codecs}


@pytest.fixture
def written(tmp_path: Path, coded: dict[str, bytes]) -> Callable[..., Path]:
    """Writes a capture with identity poses at x = 0, 1, ...; gives the video."""

    def write(suffix: str = "mp4", poses: int = COUNT) -> Path:
        lines = [f"1 0 0 {i} 0 1 0 0 0 0 1 0" for i in range(poses)]
        (tmp_path / "poses.txt").write_text("\n".join(lines))
        (tmp_path / "K.txt").write_text(K)
        (tmp_path / f"walk.{suffix}").write_bytes(coded[suffix])
        return tmp_path / f"walk.{suffix}"

    return write


Write = Callable[..., Path]


@pytest.mark.parametrize("suffix", ["mp4", "mov", "avi", "mkv", "webm"])
def test_frames_in_any_order(written: Write, suffix: str) -> None:
    capture = video.read(written(suffix))
    assert (capture.size, len(capture.frames)) == (SIZE, COUNT)
    order = [0, 1, 2, 2, 17, 18, 5, 39, 0, 38]
    assert [number_in(capture.image(i)) for i in order] == order
    np.testing.assert_array_equal(capture.world_T_cam[:, 0, 3], range(COUNT))
    assert capture.depth(0) is None


def test_going_forward_decodes_once(written: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    walk, starts = Video(written()), []
    start = Video._start
    monkeypatch.setattr(Video, "_start", lambda self: starts.append(1) or start(self))
    assert [number_in(walk.read(i)) for i in range(0, COUNT, 3)] == list(range(0, COUNT, 3))
    walk.read(39)
    assert starts == []
    walk.read(38)
    assert len(starts) == 1


def test_going_to_and_fro_decodes_once_a_place(
    written: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pairs of frames, as `check` reads them, and two reconstructions side by side."""
    walk, starts = Video(written()), []
    start = Video._start
    monkeypatch.setattr(Video, "_start", lambda self: starts.append(1) or start(self))
    order = [i for anchor in range(30) for i in (anchor, anchor + 9, anchor + 4)]
    assert [number_in(walk.read(i)) for i in order] == order
    assert len(starts) == 2
    assert number_in(walk.read(0)) == 0  # before all of them
    assert number_in(walk.read(33)) == 33


def test_the_last_frame_after_one_that_is_not_there(written: Write) -> None:
    walk = Video(written())
    for index in (COUNT, COUNT - 1, COUNT, COUNT - 1):
        assert readable(walk, index) == (index < COUNT)


def test_a_video_may_be_pickled(written: Write) -> None:
    capture = video.read(written())
    capture.image(20)
    content = pickle.dumps(capture)
    assert len(content) < 100_000
    copy = pickle.loads(content)
    assert [number_in(copy.image(i)) for i in (30, 3)] == [30, 3]
    assert number_in(capture.image(21)) == 21


def test_threads_take_turns(written: Write) -> None:
    """Two reconstructions side by side, each at its own place in the video."""
    walk = Video(written())
    places = [range(0, 30, 3), range(9, 39, 3)]
    with ThreadPoolExecutor(2) as pool:
        read = pool.map(lambda place: [number_in(walk.read(i)) for i in place], places)
        assert list(read) == [list(place) for place in places]


def test_the_file_and_its_folder(written: Write) -> None:
    file = written()
    (file.parent / "gravity-direction.txt").write_text("0 1 0")
    a, b = open_capture(file), open_capture(file.parent)
    assert (a.name, b.name) == ("walk", file.parent.name)
    np.testing.assert_array_equal(a.world_T_cam, b.world_T_cam)
    assert a.frames[:2] == ["000000", "000001"]


def test_lost_frames_keep_the_others_numbers(written: Write) -> None:
    file = written()
    lines = (file.parent / "poses.txt").read_text().splitlines()
    lines[3] = "nan " * 12
    (file.parent / "poses.txt").write_text("\n".join(lines) + "\n\n")
    capture = video.read(file)
    assert capture.frames[2:4] == ["000002", "000004"]
    assert number_in(capture.image(3)) == 4
    assert capture.skipped == ["000003: the pose has NaN or infinity (frame lost)"]


@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
@pytest.mark.parametrize(
    ("poses", "message"),
    [
        (COUNT - 1, "more than 39 frames can be decoded, poses.txt has 39 lines; write one pose a"),
        (COUNT + 1, "40 frames can be decoded, poses.txt has 41 lines"),
        (0, "more than 0 frames"),
    ],
)
def test_one_pose_a_frame(written: Write, suffix: str, poses: int, message: str) -> None:
    with pytest.raises(TFLabError, match=message):
        video.read(written(suffix, poses))


def test_phones_held_upright(tmp_path: Path, coded: dict[str, bytes]) -> None:
    (tmp_path / "a.mp4").write_bytes(held_upright(coded["mp4"]))
    upright, stored = Video(tmp_path / "a.mp4"), Video(tmp_path / "a.mp4", upright=False)
    assert (upright.size, stored.size) == (SIZE[::-1], SIZE)
    assert number_in(stored.read(7)) == 7
    np.testing.assert_array_equal(upright.read(7), np.rot90(stored.read(7), -1))
    again = pickle.loads(pickle.dumps(stored))
    assert number_in(again.read(7)) == 7


def test_files_that_are_no_videos(tmp_path: Path, coded: dict[str, bytes]) -> None:
    whole = coded["mp4"]
    for content in (b"", b"#EXTM3U\n" * 9, b"\0" * 5000, whole[: len(whole) // 2], whole[:40]):
        (tmp_path / "a.mp4").write_bytes(content)
        with pytest.raises(TFLabError, match=r"a\.mp4: cannot be read as a video; convert"):
            open_capture(tmp_path / "a.mp4")


def test_a_video_that_ends_early(tmp_path: Path, coded: dict[str, bytes]) -> None:
    whole = coded["avi"]  # its header goes first, and declares all frames
    (tmp_path / "a.avi").write_bytes(whole[: len(whole) // 2])
    walk = Video(tmp_path / "a.avi")
    last = next(i for i in range(COUNT) if not readable(walk, i))
    assert 10 < last < 30
    for index in (COUNT - 1, last, last + 1, 3, 10**6):
        if index == 3:
            assert number_in(walk.read(3)) == 3
            continue
        with pytest.raises(TFLabError, match=rf"a\.avi: frame {index} cannot be decoded"):
            walk.read(index)
    assert walk.count(COUNT + 5) == last


def readable(walk: Video, index: int) -> bool:
    try:
        walk.read(index)
    except TFLabError:
        return False
    return True


@pytest.mark.parametrize("suffix", ["mp4", "webm"])
def test_bits_that_flipped(tmp_path: Path, coded: dict[str, bytes], suffix: str) -> None:
    random = np.random.default_rng(0)
    for _ in range(10):
        content = bytearray(coded[suffix])
        for at in random.integers(len(content), size=10):
            content[at] ^= 1 << random.integers(8)
        (tmp_path / f"a.{suffix}").write_bytes(content)
        try:
            walk = Video(tmp_path / f"a.{suffix}")
        except TFLabError:
            continue
        assert walk.count(COUNT) <= COUNT
        for i in range(COUNT):
            readable(walk, i)


def test_the_file_may_vanish(written: Write) -> None:
    capture = video.read(written())
    copy = pickle.loads(pickle.dumps(capture))
    written().unlink()
    with pytest.raises(TFLabError, match="no such video"):
        copy.image(0)


def test_what_is_a_video_layout(written: Write) -> None:
    file = written()
    folder = file.parent
    assert video.detect(folder)
    assert video.detect(file)
    assert not video.detect(folder / "poses.txt")
    assert not video.detect(folder / "nowhere")
    (folder / ".hidden.mp4").write_bytes(b"")
    assert video.detect(folder)
    (folder / "images").mkdir()  # images with poses are the plain layout
    Image.new("RGB", SIZE).save(folder / "images" / "0.png")
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0")
    assert open_capture(folder, ReadSettings(gravity=(0, 1, 0))).frames == ["0"]
    (folder / "images" / "0.png").unlink()
    (folder / "images").rmdir()
    (folder / "second.MOV").write_bytes(b"")
    assert not video.detect(folder)
    with pytest.raises(TFLabError, match="2 videos"):
        open_capture(folder, ReadSettings(format="video"))


@pytest.mark.parametrize("name", ["poses.txt", "K.txt"])
def test_missing_parts(written: Write, name: str) -> None:
    file = written()
    (file.parent / name).unlink()
    with pytest.raises(TFLabError, match=f"{name}: missing"):
        open_capture(file)


def test_intrinsics_of_another_size(written: Write) -> None:
    file = written()
    (file.parent / "K.txt").write_text("40 0 320 0 41 240 0 0 1")
    with pytest.raises(TFLabError, match=r"outside the 48x32.*intrinsics_size="):
        open_capture(file)
