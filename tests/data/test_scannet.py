"""ScanNet's streams and exports against what was written, bad ones against one clear error."""

import io
import pickle
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from helpers.layouts.sens import JPEG, PNG, RAW, RAW_USHORT, ZLIB_USHORT, Stream
from helpers.lenses import moved
from tf_lab.data.readers import open_capture
from tf_lab.data.readers.source import SourceCapture
from tf_lab.data.reading import ReadSettings
from tf_lab.errors import TFLabError

COUNT = 4
SIZE, DEPTH_SIZE = (16, 12), (8, 6)
K = np.array([[15.0, 0, 7.5], [0, 16.0, 5.25], [0, 0, 1]])
DEPTH_K = np.array([[7.5, 0, 3.5], [0, 8.0, 2.375], [0, 0, 1]])  # the same camera, half the size
HEADER = 4 + 8 + len(Stream(K, SIZE, K, SIZE).sensor) + 4 * 64 + 2 * 4 + 4 * 4 + 4 + 8


def poses() -> np.ndarray:
    random = np.random.default_rng(1)
    made = np.tile(np.eye(4), (COUNT, 1, 1))
    made[:, :3, :3] = Rotation.from_rotvec(random.uniform(-1, 1, (COUNT, 3))).as_matrix()
    made[:, :3, 3] = random.uniform(-2, 2, (COUNT, 3))
    return made.astype(np.float32).astype(np.float64)  # as a stream stores them


def images() -> np.ndarray:
    return np.random.default_rng(2).integers(0, 256, (COUNT, SIZE[1], SIZE[0], 3), np.uint8)


def depths() -> np.ndarray:
    made = np.random.default_rng(3).integers(300, 5000, (COUNT, *DEPTH_SIZE[::-1]), np.uint16)
    made[:, 0, 0], made[:, 0, 1] = 0, 65535  # no reading
    return made


def metres(depth: np.ndarray) -> np.ndarray:
    return np.where(depth == 65535, 0, depth).astype(np.float32) / 1000


def empty(**changes: object) -> Stream:
    return replace(Stream(K, SIZE, DEPTH_K, DEPTH_SIZE), frames=[], **changes)  # type: ignore[arg-type]


def filled(**changes: object) -> Stream:
    stream = empty(**changes)
    for image, depth, pose in zip(images(), depths(), poses(), strict=True):
        stream.add(image, depth, pose)
    return stream


def opened(stream: Stream, tmp_path: Path) -> SourceCapture:
    capture = open_capture(stream.write(tmp_path / "scene0000_00.sens"))
    assert isinstance(capture, SourceCapture)
    return capture


def peak(action: Callable[[], object]) -> int:
    """Bytes of Python memory that an action, which may fail, takes."""
    tracemalloc.start()
    try:
        action()
    except TFLabError:
        pass
    finally:
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return most


@pytest.mark.parametrize("color", [RAW, PNG, JPEG])
@pytest.mark.parametrize("depth", [RAW_USHORT, ZLIB_USHORT])
def test_a_stream_gives_what_was_written(tmp_path: Path, color: int, depth: int) -> None:
    stream = filled(color_coding=color, depth_coding=depth)
    capture = opened(stream, tmp_path)
    assert (capture.name, capture.size, capture.skipped) == ("scene0000_00", SIZE, [])
    assert capture.frames == ["0", "1", "2", "3"]
    np.testing.assert_array_equal(capture.K, np.tile(K, (COUNT, 1, 1)))
    np.testing.assert_array_equal(capture.source_T_world, np.eye(4))  # ScanNet's z points up
    np.testing.assert_allclose(capture.world_T_cam, poses(), atol=1e-12)
    for i in range(COUNT):
        expected = images()[i]
        if color == JPEG:
            expected = np.asarray(Image.open(io.BytesIO(stream.color_bytes(expected))))
        np.testing.assert_array_equal(capture.image(i), expected)
        np.testing.assert_allclose(capture.source[i].depth(), metres(depths()[i]), atol=1e-7)  # type: ignore[misc]
        doubled = metres(depths()[i]).repeat(2, 0).repeat(2, 1)  # seen by the colour camera
        np.testing.assert_allclose(capture.depth(i), doubled, atol=1e-7)


def test_units_of_depth_are_the_header_s(tmp_path: Path) -> None:
    depth = opened(filled(depth_shift=5000.0), tmp_path).source[1].depth
    assert depth is not None
    np.testing.assert_allclose(depth(), metres(depths()[1]) / 5, atol=1e-7)


def test_a_folder_with_a_stream_opens_as_the_stream(tmp_path: Path) -> None:
    folder = tmp_path / "scene0000_00"
    filled().write(folder / "scene0000_00.sens")
    capture = open_capture(folder)
    assert (capture.name, capture.frames) == ("scene0000_00", ["0", "1", "2", "3"])
    filled().write(folder / "scene0000_01.sens")
    with pytest.raises(TFLabError, match=r"2 \.sens files"):
        open_capture(folder)


def test_a_stream_can_be_sent_to_a_worker_process(tmp_path: Path) -> None:
    capture = pickle.loads(pickle.dumps(opened(filled(), tmp_path)))
    np.testing.assert_array_equal(capture.image(2), images()[2])


def test_opening_reads_no_image(tmp_path: Path) -> None:
    stream = empty(color_size=(1296, 968), color_coding=JPEG)
    for _ in range(COUNT):
        stream.add_coded(bytes(2_000_000), b"", np.eye(4))
    path = stream.write(tmp_path / "large.sens")
    assert peak(lambda: open_capture(path)) < 200_000


def test_a_frame_without_depth_and_a_stream_without(tmp_path: Path) -> None:
    stream = filled()
    stream.add_coded(stream.color_bytes(images()[0]), b"", np.eye(4))
    assert opened(stream, tmp_path).depth(COUNT) is None
    stream = empty(depth_size=(0, 0), depth_coding=-1)
    stream.add_coded(stream.color_bytes(images()[0]), b"", np.eye(4))
    assert opened(stream, tmp_path).depth(0) is None


def test_lost_frames_are_skipped(tmp_path: Path) -> None:
    stream = empty()
    for i in range(COUNT):
        pose = np.full((4, 4), -np.inf) if i == 1 else poses()[i]
        stream.add(images()[i], depths()[i], pose)
    capture = opened(stream, tmp_path)
    assert capture.frames == ["0", "2", "3"]
    assert capture.skipped == ["1: the pose has NaN or infinity (frame lost)"]
    np.testing.assert_array_equal(capture.image(1), images()[2])


@pytest.mark.parametrize("lost", [1, 30, 96, 97, 300])  # bytes of the last frame
def test_the_whole_frames_of_a_truncated_stream_are_kept(tmp_path: Path, lost: int) -> None:
    stream = filled()
    path = tmp_path / "cut.sens"
    path.write_bytes((stream.header() + b"".join(stream.frames))[:-lost])
    capture = open_capture(path)
    assert capture.frames == ["0", "1", "2"]
    assert capture.skipped == ["3: the file ends before"]
    np.testing.assert_array_equal(capture.image(2), images()[2])
    path.write_bytes(stream.header() + b"".join(stream.frames[:2]))
    assert open_capture(path).skipped == ["2: the file ends before", "3: the file ends before"]


def test_zeros_after_an_interrupted_download(tmp_path: Path) -> None:
    stream = filled(count=100)
    path = tmp_path / "cut.sens"
    path.write_bytes(stream.header() + b"".join(stream.frames) + bytes(20_000))
    capture = open_capture(path)
    assert len(capture.frames) == COUNT
    assert capture.skipped == [f"{i}: the file is damaged there" for i in range(4, 100)]


@pytest.mark.parametrize("length", [0, 3, 11, 20, HEADER - 1])
def test_a_stream_cut_in_its_header(tmp_path: Path, length: int) -> None:
    path = tmp_path / "cut.sens"
    path.write_bytes(filled().header()[:length])
    with pytest.raises(TFLabError, match=r"cut\.sens.*(too short|within its header)"):
        open_capture(path)


BAD_HEADERS: dict[str, dict[str, object]] = {
    "version 3": {"version": 3},
    "colour coding 7": {"color_coding": 7},
    "depth coding 2": {"depth_coding": 2},
    "colour images of 0x12": {"color_size": (0, 12)},
    "colour images of 4000000000x4000000000": {"color_size": (4_000_000_000, 4_000_000_000)},
    "depth images of 8x0": {"depth_size": (8, 0)},
    "depth images of 100000x100000": {"depth_size": (100_000, 100_000)},
    "nan depth units": {"depth_shift": np.nan},
    "0 depth units": {"depth_shift": 0.0},
    "1e-38 depth units": {"depth_shift": 1e-38},
    "depth: the principal point": {"depth_size": (2, 2)},
    "colour: not a camera matrix": {"color_K": np.zeros((3, 3))},
    "depth: not a camera matrix": {"depth_K": np.full((3, 3), np.nan)},
    "depth: these extrinsics": {"depth_extrinsics": np.zeros((4, 4))},
    "colour: these extrinsics": {"color_extrinsics": np.full((4, 4), np.inf)},
    "no usable frame": {"count": 0},
}


@pytest.mark.parametrize("message", list(BAD_HEADERS))
def test_an_impossible_header_is_told(tmp_path: Path, message: str) -> None:
    path = replace(filled(), **BAD_HEADERS[message]).write(tmp_path / "bad.sens")  # type: ignore[arg-type]
    with pytest.raises(TFLabError, match=rf"bad\.sens.*{message}"):
        open_capture(path)


def test_a_name_of_impossible_length(tmp_path: Path) -> None:
    path = tmp_path / "bad.sens"
    path.write_bytes(struct.pack("<IQ", 4, 2**60) + bytes(1000))
    with pytest.raises(TFLabError, match=r"bad\.sens.*name of 1152921504606846976 bytes"):
        open_capture(path)


@pytest.mark.parametrize("sizes", [(2**62, 5), (5, 2**62), (2**63, 2**63), (10**9, 100)])
def test_a_frame_of_impossible_size_ends_the_stream(tmp_path: Path, sizes: tuple[int, int]) -> None:
    stream = filled(count=2**63)
    stream.add_coded(b"", bytes(9), np.eye(4), sizes)
    capture = opened(stream, tmp_path)
    assert len(capture.frames) == COUNT
    assert capture.skipped == [f"frames 4 to {2**63 - 1}: the file is damaged there"]
    first = empty()
    first.add_coded(b"", b"", np.eye(4), sizes)
    with pytest.raises(TFLabError, match=r"scene0000_00\.sens: 0: the file is damaged"):
        opened(first, tmp_path)


def test_frames_without_colour_are_left_out_alone(tmp_path: Path) -> None:
    stream = empty()
    for i in range(COUNT):
        color = b"" if i in (1, 2) else stream.color_bytes(images()[i])
        pose = np.full((4, 4), -np.inf) if i == 2 else poses()[i]
        stream.add_coded(color, stream.depth_bytes(depths()[i]), pose)
    capture = opened(stream, tmp_path)
    assert capture.frames == ["0", "3"]
    assert capture.skipped == [f"{i}: no colour image in the stream" for i in (1, 2)]
    np.testing.assert_array_equal(capture.image(1), images()[3])
    np.testing.assert_array_equal(capture.world_T_cam[1], poses()[3])


@pytest.mark.parametrize("count", [5, 10**6, 2**63, 2**64 - 1])
def test_more_frames_declared_than_there_are(tmp_path: Path, count: int) -> None:
    path = filled(count=count).write(tmp_path / "bad.sens")
    assert peak(lambda: open_capture(path)) < 200_000
    capture = open_capture(path)
    assert len(capture.frames) == COUNT
    assert len(capture.skipped) == 1


def png(size: tuple[int, int]) -> bytes:
    data = io.BytesIO()
    noise = np.random.default_rng(4).integers(0, 256, (size[1], size[0], 3), np.uint8)
    Image.fromarray(noise).save(data, "PNG")
    return data.getvalue()


def huge_png() -> bytes:
    """A PNG whose header says 30000x30000."""
    data = bytearray(png(SIZE))
    data[16:24] = struct.pack(">II", 30000, 30000)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return bytes(data)


BAD_COLORS: dict[str, tuple[int, bytes]] = {
    "not an image": (PNG, b"not an image"),
    "cut PNG": (PNG, png(SIZE)[:300]),
    "other size": (PNG, png((15, 12))),
    "huge size": (PNG, huge_png()),
    "short raw": (RAW, bytes(16 * 12 * 3 - 1)),
    "long raw": (RAW, bytes(16 * 12 * 3 + 1)),
}


@pytest.mark.parametrize("kind", list(BAD_COLORS))
def test_a_bad_colour_image_is_named_when_read(tmp_path: Path, kind: str) -> None:
    coding, data = BAD_COLORS[kind]
    stream = filled(color_coding=coding)
    stream.add_coded(data, stream.depth_bytes(depths()[0]), np.eye(4))
    capture = opened(stream, tmp_path)
    with pytest.raises(TFLabError, match=r"scene0000_00\.sens, frame 4, colour"):
        capture.image(4)
    np.testing.assert_array_equal(capture.image(3), images()[3])
    assert capture.depth(4) is not None


VALUES = bytes(8 * 6 * 2)
BAD_DEPTHS: dict[str, tuple[int, bytes]] = {
    "not zlib": (ZLIB_USHORT, b"not zlib"),
    "cut": (ZLIB_USHORT, zlib.compress(VALUES)[:-1]),
    "wrong sum": (ZLIB_USHORT, zlib.compress(VALUES)[:-1] + b"\x00"),
    "too few": (ZLIB_USHORT, zlib.compress(VALUES[:-1])),
    "too many": (ZLIB_USHORT, zlib.compress(VALUES + b"\x00")),
    "bomb": (ZLIB_USHORT, zlib.compress(bytes(50_000_000))),
    "short raw": (RAW_USHORT, VALUES[:-1]),
    "long raw": (RAW_USHORT, VALUES + b"\x00"),
}


@pytest.mark.parametrize("kind", list(BAD_DEPTHS))
def test_a_bad_depth_map_is_named_when_read(tmp_path: Path, kind: str) -> None:
    coding, data = BAD_DEPTHS[kind]
    stream = filled(depth_coding=coding)
    stream.add_coded(stream.color_bytes(images()[0]), data, np.eye(4))
    capture = opened(stream, tmp_path)
    with pytest.raises(TFLabError, match=r"scene0000_00\.sens, frame 4, depth"):
        capture.depth(4)
    assert peak(lambda: capture.depth(4)) < 300_000
    np.testing.assert_array_equal(capture.image(4), images()[0])


def test_a_stream_that_shrinks_or_vanishes_after_opening(tmp_path: Path) -> None:
    capture = opened(filled(), tmp_path)
    path = tmp_path / "scene0000_00.sens"
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(TFLabError, match=r"frame 3, colour|frame 3: .*shorter"):
        capture.image(3)
    path.unlink()
    with pytest.raises(TFLabError, match=r"frame 0: cannot be read"):
        capture.image(0)


# A plane that slants in both directions, n . X = 1 in the world; its depth in any camera is known.
PLANE = np.array([0.15, -0.2, 0.45])
WORLD_T_COLOR = np.eye(4)
WORLD_T_COLOR[:3, :3] = Rotation.from_rotvec([0.1, -0.15, 0.05]).as_matrix()
WORLD_T_COLOR[:3, 3] = [0.1, -0.05, 0.2]
RIG_K = np.array([[62.0, 0, 33.0], [0, 60.0, 22.5], [0, 0, 1]])
RIG_DEPTH_K = np.array([[29.0, 0, 14.0], [0, 30.0, 12.5], [0, 0, 1]])
RIG_SIZE, RIG_DEPTH_SIZE = (64, 48), (32, 24)


def plane_depth(world_T_cam: np.ndarray, K: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], -1)
    normal = PLANE @ world_T_cam[:3, :3]
    return np.asarray((1 - PLANE @ world_T_cam[:3, 3]) / (rays @ normal))


def rig_stream(color_extrinsics: np.ndarray, depth_extrinsics: np.ndarray) -> Stream:
    """One frame: the depth camera is where the extrinsics have it; the pose is the depth's."""
    color_T_depth = np.linalg.inv(color_extrinsics) @ depth_extrinsics
    world_T_depth = WORLD_T_COLOR @ color_T_depth
    stream = Stream(
        RIG_K, RIG_SIZE, RIG_DEPTH_K, RIG_DEPTH_SIZE,
        color_extrinsics=color_extrinsics, depth_extrinsics=depth_extrinsics, depth_shift=20000.0,
    )  # fmt: skip
    depth = plane_depth(world_T_depth, RIG_DEPTH_K, RIG_DEPTH_SIZE)
    stream.add(np.zeros((48, 64, 3), np.uint8), np.round(depth * 20000), world_T_depth)
    return stream


RIGS = {
    "one place": (np.eye(4), np.eye(4)),
    "depth to colour": (np.eye(4), moved([0.01, 0.06, -0.03], [0.04, -0.01, 0.02])),
    "both": (moved([0, 0.3, 0], [1, 0, 0]), moved([0.02, 0.27, 0], [0.95, 0.02, -0.03])),
}


@pytest.mark.parametrize("name", list(RIGS))
def test_depth_is_registered_to_the_colour_camera(tmp_path: Path, name: str) -> None:
    capture = opened(rig_stream(*RIGS[name]), tmp_path)
    np.testing.assert_allclose(capture.world_T_cam[0], WORLD_T_COLOR, atol=1e-6)
    assert (capture.source[0].color_T_depth is None) == (name == "one place")
    depth = capture.depth(0)
    assert depth is not None
    expected = plane_depth(WORLD_T_COLOR, RIG_K, RIG_SIZE)
    seen = depth > 0
    assert seen.mean() > 0.7
    error = (depth - expected)[seen]
    half_pixel = 0.5 * np.abs(np.gradient(expected)).max() * 62 / 29
    assert np.abs(error).max() < 2.1 * half_pixel  # in both directions
    assert abs(error.mean()) < 0.15 * half_pixel
    raw = capture.source[0].depth().repeat(2, 0).repeat(2, 1)  # type: ignore[misc]
    assert np.abs(raw - expected)[seen].mean() > 2 * np.abs(error).mean()


def lying(K: np.ndarray, size: tuple[int, int], turn: int) -> np.ndarray:
    """The intrinsics of images that are those of K once they are turned clockwise."""
    (fx, _, cx), (_, fy, cy), _ = K
    width, height = size
    x, y = (cy, width - 1 - cx) if turn == 90 else (height - 1 - cy, cx)
    return np.array([[fy, 0, x], [0, fx, y], [0, 0, 1]])


@pytest.mark.parametrize("turn", [90, 270])
@pytest.mark.parametrize("name", list(RIGS))
def test_a_rig_whose_images_lie_is_turned_as_a_whole(tmp_path: Path, name: str, turn: int) -> None:
    """Both sensors were mounted lying; the poses are those of the upright depth camera."""
    upright = opened(rig_stream(*RIGS[name]), tmp_path)
    color_T_depth = np.linalg.inv(RIGS[name][0]) @ RIGS[name][1]
    world_T_depth = WORLD_T_COLOR @ color_T_depth
    # x right, y down of a lying camera are y, -x of the upright one, or -y, x
    lying_T_upright = np.eye(4)
    lying_T_upright[:2, :2] = [[0, 1], [-1, 0]] if turn == 90 else [[0, -1], [1, 0]]
    stream = Stream(
        lying(RIG_K, RIG_SIZE, turn), RIG_SIZE[::-1],
        lying(RIG_DEPTH_K, RIG_DEPTH_SIZE, turn), RIG_DEPTH_SIZE[::-1],
        depth_extrinsics=lying_T_upright @ color_T_depth @ lying_T_upright.T, depth_shift=20000.0,
    )  # fmt: skip
    depth = np.rot90(plane_depth(world_T_depth, RIG_DEPTH_K, RIG_DEPTH_SIZE), turn // 90)
    stream.add(np.zeros((64, 48, 3), np.uint8), np.round(depth * 20000), world_T_depth)
    path = stream.write(tmp_path / "lying.sens")
    found = open_capture(path, ReadSettings(turn=turn))
    assert found.size == RIG_SIZE
    np.testing.assert_allclose(found.K, upright.K, atol=1e-4)
    np.testing.assert_allclose(found.world_T_cam, upright.world_T_cam, atol=1e-6)
    expected, depth = upright.depth(0), found.depth(0)
    assert expected is not None and depth is not None
    assert ((depth > 0) == (expected > 0)).mean() > 0.98
    np.testing.assert_allclose(depth, expected, atol=0.04 * float(expected.max()))
    assert np.abs(depth - expected).mean() < 1e-3


def test_a_lost_frame_of_a_rig(tmp_path: Path) -> None:
    stream = rig_stream(*RIGS["both"])
    stream.add(np.zeros((48, 64, 3), np.uint8), np.zeros((24, 32)), np.full((4, 4), -np.inf))
    assert opened(stream, tmp_path).skipped == ["1: the pose has NaN or infinity (frame lost)"]


def write_export(folder: Path, jpeg: bool = False) -> Path:
    for name in ("color", "depth", "pose", "intrinsic"):
        (folder / name).mkdir(parents=True)
    for camera, matrix in (("color", K), ("depth", DEPTH_K)):
        square = np.eye(4)
        square[:3, :3] = matrix
        np.savetxt(folder / "intrinsic" / f"intrinsic_{camera}.txt", square, fmt="%.6f")
    for i in range(COUNT):
        ending = {"format": "JPEG", "quality": 95} if jpeg else {"format": "PNG"}
        name = f"{i}.jpg" if jpeg else f"{i}.png"
        Image.fromarray(images()[i]).save(folder / "color" / name, **ending)
        Image.fromarray(depths()[i]).save(folder / "depth" / f"{i}.png")
        np.savetxt(folder / "pose" / f"{i}.txt", poses()[i], fmt="%.9f")
    return folder


def test_an_export_gives_what_its_stream_gives(tmp_path: Path) -> None:
    stream = opened(filled(color_coding=JPEG), tmp_path)
    export = open_capture(write_export(tmp_path / "scene0000_00", jpeg=True))
    assert (export.name, export.frames) == (stream.name, stream.frames)
    np.testing.assert_array_equal(export.K, stream.K)
    np.testing.assert_allclose(export.world_T_cam, stream.world_T_cam, atol=1e-8)
    for i in range(COUNT):
        np.testing.assert_array_equal(export.image(i), stream.image(i))
        np.testing.assert_array_equal(export.depth(i), stream.depth(i))


def test_depth_of_an_export_as_arrays(tmp_path: Path) -> None:
    folder = write_export(tmp_path / "scene")
    expected = [open_capture(folder).depth(i) for i in range(COUNT)]
    for i in range(COUNT):
        (folder / "depth" / f"{i}.png").unlink()
        np.save(folder / "depth" / f"{i}.npy", depths()[i])
    capture = open_capture(folder)
    for i in range(COUNT):
        np.testing.assert_array_equal(capture.depth(i), expected[i])


def test_the_extrinsics_of_an_export(tmp_path: Path) -> None:
    folder = write_export(tmp_path / "scene")
    extrinsics = moved([0.01, 0.06, -0.03], [0.04, -0.01, 0.02])
    np.savetxt(folder / "intrinsic" / "extrinsic_depth.txt", extrinsics)
    capture = open_capture(folder)
    np.testing.assert_allclose(capture.world_T_cam @ extrinsics, poses(), atol=1e-8)
    assert isinstance(capture, SourceCapture)
    np.testing.assert_allclose(capture.source[0].color_T_depth, extrinsics)  # type: ignore[arg-type]


def test_frames_missing_from_an_export(tmp_path: Path) -> None:
    folder = write_export(tmp_path / "scene")
    (folder / "pose" / "0.txt").write_text("-inf " * 16)
    (folder / "pose" / "1.txt").unlink()
    (folder / "color" / "2.png").unlink()
    (folder / "depth" / "3.png").unlink()
    capture = open_capture(folder)
    assert capture.frames == ["3"]
    assert capture.depth(0) is None
    image, pose, lost = capture.skipped
    assert image == "2: no colour image"
    assert pose == "1: no pose"
    assert lost == "0: the pose has NaN or infinity (frame lost)"


def test_frames_25k(tmp_path: Path) -> None:
    """Its intrinsics lie beside color/, and there are no extrinsics."""
    export, folder = write_export(tmp_path / "export"), write_export(tmp_path / "scene0000_00")
    for camera in ("color", "depth"):
        path = folder / "intrinsic" / f"intrinsic_{camera}.txt"
        path.rename(folder / f"intrinsics_{camera}.txt")
    (folder / "intrinsic").rmdir()
    found, expected = open_capture(folder), open_capture(export)
    assert found.frames == expected.frames
    np.testing.assert_array_equal(found.K, expected.K)
    np.testing.assert_array_equal(found.depth(0), expected.depth(0))


def test_an_export_without_depth(tmp_path: Path) -> None:
    folder = write_export(tmp_path / "scene")
    for path in [*folder.glob("depth/*"), folder / "intrinsic" / "intrinsic_depth.txt"]:
        path.unlink()
    assert open_capture(folder).depth(0) is None


@pytest.mark.parametrize("content", ["", "1 2 3", "x " * 16, "nan " * 16, "0 " * 16])
@pytest.mark.parametrize("name", ["intrinsic_color", "intrinsic_depth", "extrinsic_depth"])
def test_a_bad_matrix_of_an_export_is_named(tmp_path: Path, name: str, content: str) -> None:
    folder = write_export(tmp_path / "scene")
    (folder / "intrinsic" / f"{name}.txt").write_text(content)
    with pytest.raises(TFLabError, match=name):
        open_capture(folder)


def test_unreadable_images_of_an_export(tmp_path: Path) -> None:
    folder = write_export(tmp_path / "scene")
    for path in folder.glob("depth/*"):
        path.write_bytes(b"")
    with pytest.raises(TFLabError, match=r"depth.*can be read"):
        open_capture(folder)
