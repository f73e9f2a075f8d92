"""Image and depth files as people have them: odd ones, turned ones, of other kinds and names."""

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from tf_lab.data.capture import Capture, read_depth, read_image
from tf_lab.data.lens import Camera
from tf_lab.data.readers import open_capture, plain
from tf_lab.data.readers.images import at_file_size, image_files, image_size, match_depths
from tf_lab.data.reading import ReadSettings
from tf_lab.errors import TFLabError

COUNT = 5
SIZE = (32, 24)
K = np.array([[30.0, 0, 15.75], [0, 31.0, 11.25], [0, 0, 1]])
PORTRAIT_K = np.array([[31.0, 0, 11.25], [0, 30.0, 15.75], [0, 0, 1]])
DEPTH = np.linspace(0.5, 4, SIZE[0] * SIZE[1]).reshape(SIZE[::-1]).round(3)


def picture(i: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Smooth, so that JPEG keeps it; brighter to the right and downwards, each its own blue."""
    x, y = np.meshgrid(np.linspace(0, 255, size[0]), np.linspace(0, 200, size[1]))
    return np.stack([x, y, np.full(x.shape, 40 * i)], -1).astype(np.uint8)


def write(folder: Path, K: np.ndarray = K) -> Path:
    """A plain capture of `COUNT` landscape pictures."""
    (folder / "images").mkdir(parents=True)
    np.savetxt(folder / "K.txt", K)
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, 0, 3] = np.arange(COUNT)
    np.savetxt(folder / "poses.txt", poses.reshape(COUNT, 16))
    for i in range(COUNT):
        Image.fromarray(picture(i)).save(folder / "images" / f"{i}.png")
    return folder


def opened(folder: Path) -> Capture:
    return open_capture(folder, ReadSettings(gravity=(0, 1, 0)))


def save_jpeg(path: Path, pixels: np.ndarray, orientation: int | None = None) -> None:
    exif = Image.Exif()
    if orientation is not None:
        exif[ExifTags.Base.Orientation] = orientation
    Image.fromarray(pixels).save(path, "JPEG", quality=98, exif=exif)


def close(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and np.abs(a.astype(int) - b).max() < 12  # JPEG


@pytest.mark.parametrize("odd", [(16, 12), (24, 32), (64, 48)])
def test_the_first_picture_does_not_decide(tmp_path: Path, odd: tuple[int, int]) -> None:
    folder = write(tmp_path / "a")
    Image.fromarray(picture(0, odd)).save(folder / "images" / "0.png")
    capture = opened(folder)
    assert capture.size == SIZE
    for i in range(1, COUNT):
        np.testing.assert_array_equal(capture.image(i), picture(i))
    with pytest.raises(TFLabError, match=rf"0\.png: is {odd[0]}x{odd[1]}, its camera 32x24"):
        capture.image(0)


def test_the_intrinsics_go_before_the_majority(tmp_path: Path) -> None:
    folder = write(tmp_path / "a")
    for i in (0, 1, 2):  # most, but K is of the others
        Image.fromarray(picture(i, (64, 48))).save(folder / "images" / f"{i}.png")
    assert opened(folder).size == SIZE


def test_sizes_follow_the_majority(tmp_path: Path) -> None:
    files = [tmp_path / f"{i}.png" for i in range(300)]
    for i, path in enumerate(files):
        Image.new("L", (9, 8) if i % 3 else (4, 3)).save(path)
    files[0].write_bytes(b"")
    assert image_size(files) == (9, 8)
    assert image_size(files, (1.5, 1)) == (4, 3)
    cameras = [Camera((18, 16), 20.0, 20.0, 8.5, 7.5)] * 300
    assert at_file_size(cameras, files)[0].size == (9, 8)  # resized
    with pytest.raises(TFLabError, match="of another shape"):
        at_file_size([Camera((40, 16), 20.0, 20.0, 8.5, 7.5)] * 300, files)


def portrait(i: int) -> np.ndarray:
    return picture(i, SIZE[::-1])


# how a phone stores an upright picture lying, and the EXIF orientation that says so
LYING = {6: lambda upright: np.rot90(upright), 8: lambda upright: np.rot90(upright, -1)}


@pytest.mark.parametrize("orientation", list(LYING))
def test_pictures_are_turned_where_the_intrinsics_are_upright(
    tmp_path: Path, orientation: int
) -> None:
    folder = write(tmp_path / "a", PORTRAIT_K)
    for i in range(COUNT):
        (folder / "images" / f"{i}.png").unlink()
        save_jpeg(folder / "images" / f"{i}.jpg", LYING[orientation](portrait(i)), orientation)
    capture = opened(folder)
    assert capture.size == SIZE[::-1]
    np.testing.assert_array_equal(capture.K[0], PORTRAIT_K)
    assert all(close(capture.image(i), portrait(i)) for i in range(COUNT))


def test_pictures_stay_as_stored_where_the_intrinsics_are_lying(tmp_path: Path) -> None:
    folder = write(tmp_path / "a")
    for i in range(COUNT):
        (folder / "images" / f"{i}.png").unlink()
        save_jpeg(folder / "images" / f"{i}.jpg", picture(i), 6)
    capture = opened(folder)
    assert capture.size == SIZE
    assert all(close(capture.image(i), picture(i)) for i in range(COUNT))


def test_a_turned_picture_among_others_is_told_or_turned(tmp_path: Path) -> None:
    folder = write(tmp_path / "a")
    save_jpeg(folder / "images" / "1.png", np.rot90(picture(1)), 6)  # EXIF makes it fit
    save_jpeg(folder / "images" / "2.png", np.rot90(picture(2)))  # nothing does
    capture = opened(folder)
    assert close(capture.image(1), picture(1))
    with pytest.raises(TFLabError, match=r"2\.png: is 24x32, its camera 32x24"):
        capture.image(2)


def test_stated_sizes_turn_pictures_too(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    save_jpeg(path, np.rot90(portrait(1)), 6)
    for size in (SIZE, SIZE[::-1]):
        assert at_file_size([Camera(size, 30.0, 30.0, 12.0, 12.0)], [path])[0].size == size
        assert read_image(path, size).shape[:2] == size[::-1]


@pytest.mark.parametrize("mode", ["L", "LA", "RGBA", "I;16"])
def test_pictures_of_other_kinds(tmp_path: Path, mode: str) -> None:
    grey = picture(0)[..., 0]
    made = Image.fromarray(grey).convert(mode)
    if mode == "I;16":
        made = Image.fromarray(grey.astype(np.uint16) * 257)
    made.save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), np.stack([grey] * 3, -1))


DEPTH_FILES: dict[str, Callable[[Path], None]] = {
    "16-bit PNG": lambda f: Image.fromarray((DEPTH * 1000).round().astype(np.uint16)).save(
        f.with_suffix(".png")
    ),
    "16-bit TIFF": lambda f: Image.fromarray((DEPTH * 1000).round().astype(np.uint16)).save(
        f.with_suffix(".tiff")
    ),
    "float TIFF": lambda f: Image.fromarray(DEPTH.astype(np.float32)).save(f.with_suffix(".tif")),
    "float numpy": lambda f: np.save(f.with_suffix(".npy"), DEPTH.astype(np.float32)),
    "double numpy": lambda f: np.save(f.with_suffix(".npy"), DEPTH[..., None]),
    "16-bit numpy": lambda f: np.save(
        f.with_suffix(".npy"), (DEPTH * 1000).round().astype(np.uint16)
    ),
}


@pytest.mark.parametrize("ending", ["png", "pgm", "tif"])
def test_the_largest_of_16_bits_is_no_reading(tmp_path: Path, ending: str) -> None:
    values = np.array([[0, 1000], [2500, 65535]], np.uint16)
    Image.fromarray(values).save(tmp_path / f"a.{ending}")
    np.testing.assert_array_equal(read_depth(tmp_path / f"a.{ending}"), [[0, 1], [2.5, 0]])


@pytest.mark.parametrize("kind", list(DEPTH_FILES))
def test_depth_of_every_kind(tmp_path: Path, kind: str) -> None:
    folder = write(tmp_path / "a")
    (folder / "depth").mkdir()
    for i in range(COUNT):
        DEPTH_FILES[kind](folder / "depth" / str(i))
    np.testing.assert_allclose(opened(folder).depth(3), DEPTH, atol=1e-6)


def test_no_readings_of_floating_point_depth(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([[np.nan, np.inf, -1, 0, 2.5]]))
    np.testing.assert_array_equal(read_depth(tmp_path / "a.npy"), [[0, 0, 0, 0, 2.5]])


def test_depth_of_unknown_unit_is_refused(tmp_path: Path) -> None:
    folder = write(tmp_path / "a")
    (folder / "depth").mkdir()
    path = folder / "depth" / "1.png"
    Image.fromarray((DEPTH * 50).astype(np.uint8)).save(path)
    with pytest.raises(TFLabError, match=r"1\.png: 8-bit depth .* give depth_scale=UNITS"):
        opened(folder).depth(1)
    stated = open_capture(folder, ReadSettings(gravity=(0, 1, 0), depth_scale=50))
    np.testing.assert_allclose(stated.depth(1), DEPTH, atol=0.02)
    np.save(tmp_path / "b.npy", (DEPTH * 1000).astype(np.float32))
    with pytest.raises(TFLabError, match=r"b\.npy: .* 2250 in the median; give depth_scale"):
        read_depth(tmp_path / "b.npy")
    np.testing.assert_allclose(read_depth(tmp_path / "b.npy", 1000), DEPTH, atol=1e-6)


@pytest.mark.parametrize("content", [np.zeros((2, 3, 4)), np.array(["a"] * 4).reshape(2, 2)])
def test_files_that_are_no_depth(tmp_path: Path, content: np.ndarray) -> None:
    np.save(tmp_path / "a.npy", content)
    with pytest.raises(TFLabError, match=r"a\.npy: "):
        read_depth(tmp_path / "a.npy")


IMAGES = ["frame_2", "frame_10", "frame_11"]
PAIRS = {
    "stems": ["frame_2", "frame_10", "frame_11"],
    "some stems": ["frame_10"],
    "numbers": ["2_mm", "10_mm", "11_mm"],
    "padded": ["depth-002", "depth-010", "depth-011"],
    "some numbers": ["10.depth"],
    "order": ["a", "b", "c"],
    "order, other numbers": ["1", "2", "10"],
}


@pytest.mark.parametrize("kind", list(PAIRS))
def test_depth_files_find_their_images(
    tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    images = [tmp_path / "images" / f"{name}.jpg" for name in IMAGES]
    (tmp_path / "depth").mkdir()
    for name in PAIRS[kind]:
        (tmp_path / "depth" / f"{name}.png").touch()
    found = match_depths(tmp_path / "depth", images)
    which = [1] if kind.startswith("some") else [0, 1, 2]
    paired = {IMAGES[i]: name for i, name in zip(which, PAIRS[kind], strict=True)}
    assert {image.stem: depth.stem for image, depth in found.items()} == paired
    assert ("by their order" in caplog.text) == kind.startswith("order")
    assert len(caplog.records) == kind.startswith("order")


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (["a.png", "b.png"], "not used: 2 depth files, 3 images, and names as a.png"),
        (["2.png", "3.png"], "not used: 2 depth files"),
        (["frame_2.exr"], "not used: none of .png, .npy"),
        (["frame_2.png", "x.png"], "1 of its files belong to no image"),
    ],
)
def test_depth_that_is_not_used_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, files: list[str], message: str
) -> None:
    images = [tmp_path / "images" / f"{name}.jpg" for name in IMAGES]
    assert match_depths(tmp_path / "depth", images) == {}
    (tmp_path / "depth").mkdir()
    for name in files:
        (tmp_path / "depth" / name).touch()
    with caplog.at_level(logging.WARNING):
        match_depths(tmp_path / "depth", images)
    assert message in caplog.text


def test_a_folder_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write(tmp_path / "a")

    def refuse(path: Path) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "iterdir", refuse)  # root may read everything
    with pytest.raises(TFLabError, match=r"images: cannot be read \(Permission denied\)"):
        plain.read(folder)


@pytest.mark.parametrize(
    "stems",
    [
        [str(round(1693224432 + i * 0.05, 2)) for i in range(25)],  # seconds, as Python prints them
        [str(round(i * 0.04, 2)) for i in range(60)],
        [f"{i // 12}.{i % 12 + 1}" for i in range(30)],  # counters of two numbers
        [f"{i}" for i in range(12)],
        [f"frame-{i}.color" for i in range(12)],
    ],
)
def test_images_are_in_order_of_time(tmp_path: Path, stems: list[str]) -> None:
    for stem in stems:
        (tmp_path / f"{stem}.png").touch()
    assert [path.stem for path in image_files(tmp_path)] == stems


@pytest.mark.parametrize("shape", [(32, 24), (18, 32)])  # turned, cropped
def test_depth_of_another_shape_is_refused(tmp_path: Path, shape: tuple[int, int]) -> None:
    folder = write(tmp_path / "a")
    (folder / "depth").mkdir()
    for i in range(COUNT):
        np.save(folder / "depth" / f"{i}.npy", DEPTH.astype(np.float32))
    np.save(folder / "depth" / "3.npy", np.ones(shape, np.float32))
    np.save(folder / "depth" / "4.npy", np.full((12, 16), 2, np.float32))  # half the size
    capture = opened(folder)
    told = rf"3\.npy: is {shape[1]}x{shape[0]}, its image 32x24, of another shape; turn or crop it"
    with pytest.raises(TFLabError, match=told):
        capture.depth(3)
    for i, known in ((0, DEPTH), (4, np.full(DEPTH.shape, 2))):
        depth = capture.depth(i)
        assert depth is not None
        np.testing.assert_allclose(depth, known, atol=1e-3)


def test_only_16_bit_depth_has_a_largest_number(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.full((2, 3), 300_000, np.uint32))  # 3 m in units of 0.01 mm
    np.testing.assert_allclose(read_depth(path, 100_000), 3)
    np.save(path, np.full((2, 3), 65535, np.uint16))
    assert not read_depth(path, 1000).any()
    Image.fromarray(np.full((2, 3), 65535, np.uint16)).save(tmp_path / "a.png")
    assert not read_depth(tmp_path / "a.png", 1000).any()


def test_images_of_one_odd_camera_do_not_stop_the_others(tmp_path: Path) -> None:
    files = [tmp_path / f"{i}.png" for i in range(3)]
    for file in files[:2]:
        Image.fromarray(picture(0)).save(file)
    files[2].touch()
    usual, odd = Camera(SIZE, 30, 31, 15.75, 11.25), Camera((40, 20), 30, 31, 19.5, 9.5)
    assert at_file_size([usual, usual, odd], files) == [usual, usual, odd]
    with pytest.raises(TFLabError, match=r"2\.png: not one of the colour images"):
        at_file_size([odd], files[2:])
