"""COLMAP's sparse models: its poses, every lens, text and binary, and damage."""

import logging
import shutil
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers import lenses
from tf_lab.data.readers import colmap, open_capture
from tf_lab.data.readers.source import SourceCapture
from tf_lab.data.reading import ReadSettings
from tf_lab.errors import TFLabError

SIZE = (120, 90)
PINHOLE = "1 PINHOLE 120 90 110 112 61 44.5"
K = np.array([[110.0, 0, 60.5], [0, 112.0, 44.0], [0, 0, 1]])  # pixel centres at integers
# A camera at (1, 2, 3), turned by 90 degrees about y: its x axis is the world's -z, its z axis +x.
# cam_T_world: x_cam = -z + 3, y_cam = y - 2, z_cam = x - 1
QUATERNION, TRANSLATION = (0.5**0.5, 0.0, -(0.5**0.5), 0.0), (3.0, -2.0, -1.0)
WORLD_T_CAM = [[0, 0, 1, 1], [0, 1, 0, 2], [-1, 0, 0, 3], [0, 0, 0, 1]]
POSE = " ".join(str(v) for v in QUATERNION + TRANSLATION)
IMAGE = f"1 {POSE} 1 0.png\n1 2 3\n"

MODELS: dict[str, tuple[int, Sequence[float], lenses.Lens | None]] = {
    "SIMPLE_PINHOLE": (0, (110, 61, 44.5), None),
    "PINHOLE": (1, (110, 112, 61, 44.5), None),
    "SIMPLE_RADIAL": (2, (110, 61, 44.5, -0.2), lenses.perspective(-0.2)),
    "RADIAL": (3, (110, 61, 44.5, -0.2, 0.05), lenses.perspective(-0.2, 0.05)),
    "OPENCV": (4, (110, 112, 61, 44.5, -0.2, 0.05, 0.003, -0.002),
               lenses.perspective(-0.2, 0.05, 0.003, -0.002)),
    "OPENCV_FISHEYE": (5, (110, 112, 61, 44.5, 0.03, -0.01, 0.004, -0.001),
                       lenses.fisheye(0.03, -0.01, 0.004, -0.001)),
    "FULL_OPENCV": (6, (110, 112, 61, 44.5, 0.5, 0.1, 0.001, -0.002, 0.01, 0.8, 0.2, 0.02),
                    lenses.perspective(0.5, 0.1, 0.001, -0.002, 0.01, 0.8, 0.2, 0.02)),
    "SIMPLE_RADIAL_FISHEYE": (8, (110, 61, 44.5, 0.05), lenses.fisheye(0.05)),
    "RADIAL_FISHEYE": (9, (110, 61, 44.5, 0.05, -0.02), lenses.fisheye(0.05, -0.02)),
    "SIMPLE_FISHEYE": (14, (110, 61, 44.5), lenses.fisheye()),
    "FISHEYE": (15, (110, 112, 61, 44.5), lenses.fisheye()),
}  # fmt: skip
UNKNOWN = {"FOV": (7, 5), "THIN_PRISM_FISHEYE": (10, 12), "RAD_TAN_THIN_PRISM_FISHEYE": (11, 16)}


def write_images(folder: Path, images: int = 1) -> None:
    (folder / "images").mkdir(exist_ok=True)
    for i in range(images):
        Image.new("RGB", SIZE, (i, 2 * i, 3 * i)).save(folder / "images" / f"{i}.png")


@pytest.fixture
def text(tmp_path: Path) -> Callable[..., Path]:
    """Writes a model as text, in the folder itself; gives the folder."""

    def write(cameras: str = PINHOLE, images: str = IMAGE, count: int = 1) -> Path:
        write_images(tmp_path, count)
        (tmp_path / "cameras.txt").write_text(cameras)
        (tmp_path / "images.txt").write_text(images)
        return tmp_path

    return write


@pytest.fixture
def binary(tmp_path: Path) -> Callable[..., Path]:
    """Writes the same model as binary."""

    def write(
        model: int = 1, values: Sequence[float] = (110, 112, 61, 44.5), count: int = 1
    ) -> Path:
        write_images(tmp_path, count)
        (tmp_path / "cameras.bin").write_bytes(
            struct.pack(f"<QIiQQ{len(values)}d", 1, 1, model, *SIZE, *values)
        )
        images = [
            struct.pack("<I7dI", 1, *QUATERNION, *TRANSLATION, 1)
            + f"{i}.png\0".encode()
            + struct.pack("<QddQ", 1, 1.0, 2.0, 3)
            for i in range(count)
        ]
        (tmp_path / "images.bin").write_bytes(struct.pack("<Q", count) + b"".join(images))
        return tmp_path

    return write


Write = Callable[..., Path]


def assert_same(a: SourceCapture, b: SourceCapture) -> None:
    assert (a.frames, a.size, a.skipped, a.cameras) == (b.frames, b.size, b.skipped, b.cameras)
    np.testing.assert_array_equal(a.world_T_cam, b.world_T_cam)
    np.testing.assert_array_equal(a.image(0), b.image(0))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_texts_that_were_saved_on_windows(text: Write, encoding: str) -> None:
    plain = colmap.read(text())
    for name in ("cameras.txt", "images.txt"):
        path = text() / name
        path.write_text(path.read_text(), encoding=encoding, newline="\r\n")
        assert_same(colmap.read(path.parent), plain)


def test_a_known_camera(text: Write) -> None:
    capture = colmap.read(text())
    np.testing.assert_allclose(capture.world_T_cam[0], WORLD_T_CAM, atol=1e-15)
    np.testing.assert_allclose(capture.K[0], K)
    assert (capture.frames, capture.size, capture.metric) == (["0"], SIZE, False)


@pytest.mark.parametrize("name", list(MODELS))
@pytest.mark.parametrize("form", ["text", "binary"])
def test_every_lens_is_straightened(text: Write, binary: Write, name: str, form: str) -> None:
    number, values, lens = MODELS[name]
    line = f"1 {name} 120 90 {' '.join(map(str, values))}"
    folder = text(line) if form == "text" else binary(number, values)
    focal = K.copy()
    focal[1, 1] = 110 if values[1] == 61 else 112  # one focal length, or two
    Image.fromarray(lenses.photograph(focal, SIZE, lens)).save(folder / "images" / "0.png")
    capture = colmap.read(folder)
    if lens is None:
        np.testing.assert_allclose(capture.K[0], focal)
    expected = lenses.colours(lenses.slopes_of(capture.K[0], SIZE))
    assert np.abs(capture.image(0) - expected)[2:-2, 2:-2].max() < 2.5


@pytest.mark.parametrize("name", list(UNKNOWN))
def test_other_lenses_are_named_with_a_cure(text: Write, binary: Write, name: str) -> None:
    number, count = UNKNOWN[name]
    message = f"{name} is not supported; undistort.*image_undistorter"
    with pytest.raises(TFLabError, match=message):
        colmap.read(text(f"1 {name} 120 90 {'1 ' * count}"))
    with pytest.raises(TFLabError, match=message):
        colmap.read(binary(number, [1.0] * count))
    with pytest.raises(TFLabError, match="number 99 is not supported"):
        colmap.read(binary(99))


def test_text_and_binary_are_the_same(text: Write, binary: Write, tmp_path: Path) -> None:
    of_text = colmap.read(text())
    (tmp_path / "cameras.txt").write_text("broken: the binary model is preferred")
    assert_same(colmap.read(binary()), of_text)


@pytest.mark.parametrize("place", ["sparse/0", "sparse", "."])
def test_places_of_the_model(text: Write, tmp_path: Path, place: str) -> None:
    expected = colmap.read(text())
    (tmp_path / "scene" / place).mkdir(parents=True)
    shutil.copytree(tmp_path / "images", tmp_path / "scene" / "images")
    for name in ("cameras.txt", "images.txt"):
        (tmp_path / name).rename(tmp_path / "scene" / place / name)
    assert_same(colmap.read(tmp_path / "scene"), expected)
    assert_same(colmap.read(tmp_path / "scene" / place), expected)  # images/ is found above


def several_models(folder: Path, write: Callable[[int], Path]) -> Path:
    """sparse/0 of one image, sparse/1 of three, sparse/2 of two."""
    for part, count in enumerate([1, 3, 2]):
        write(count)
        (folder / "sparse" / str(part)).mkdir(parents=True)
        for file in [*folder.glob("*.txt"), *folder.glob("*.bin")]:
            file.rename(folder / "sparse" / str(part) / file.name)
    write_images(folder, 3)
    return folder


def repeated(text: Write) -> Callable[[int], Path]:
    return lambda count: text(images="".join(f"1 {POSE} 1 {i}.png\n\n" for i in range(count)))


@pytest.mark.parametrize("form", ["text", "binary"])
def test_the_largest_of_several_models(
    tmp_path: Path, text: Write, binary: Write, form: str, caplog: pytest.LogCaptureFixture
) -> None:
    write = repeated(text) if form == "text" else lambda count: binary(count=count)
    folder = several_models(tmp_path, write)
    with caplog.at_level(logging.WARNING):
        capture = colmap.read(folder)
    assert "sparse/1: the largest of 3 models, with 3 images of 6" in caplog.text
    assert capture.frames == ["0", "1", "2"]
    assert colmap.read(folder / "sparse" / "2").frames == ["0", "1"]  # another, by its folder
    for part in "02":
        shutil.rmtree(folder / "sparse" / part)
    assert_same(colmap.read(folder), capture)  # only sparse/1


def test_damaged_models_beside_a_good_one(tmp_path: Path, text: Write) -> None:
    folder = several_models(tmp_path, repeated(text))
    for name in ("cameras.bin", "images.bin"):  # of a count that the file cannot hold
        (folder / "sparse" / "0" / name).write_bytes(b"\xff" * 20)
    (folder / "sparse" / "2" / "images.txt").write_bytes(b"\xff" * 20)
    assert colmap.read(folder).frames == ["0", "1", "2"]


def test_images_of_another_folder(text: Write, tmp_path: Path) -> None:
    folder = text()
    (folder / "images").rename(folder / "input")
    assert colmap.read(folder).image(0).shape == (90, 120, 3)
    (folder / "images").mkdir()
    Image.new("RGB", SIZE).save(folder / "images" / "other.png")  # not of this model
    assert colmap.read(folder).frames == ["0"]


@pytest.mark.parametrize("turned", [0, 2])
def test_one_turned_picture_is_told_alone(text: Write, turned: int) -> None:
    folder = text(images="".join(f"{i} {POSE} 1 {i}.png\n\n" for i in range(4)), count=4)
    Image.new("RGB", SIZE[::-1]).save(folder / "images" / f"{turned}.png")
    capture = colmap.read(folder)
    right = sorted({0, 1, 2, 3} - {turned})
    assert [capture.image(i)[0, 0, 0] for i in right] == right
    with pytest.raises(TFLabError, match=rf"{turned}\.png: is 90x120, its camera 120x90"):
        capture.image(turned)


def test_the_scale_must_be_given(text: Write) -> None:
    folder = text()
    with pytest.raises(TFLabError, match=r"unit of length is unknown.*scale=METRES_PER_UNIT"):
        open_capture(folder, ReadSettings(gravity=(0, 1, 0)))
    capture = open_capture(folder, ReadSettings(gravity=(0, 0, -1), scale=2.0))
    np.testing.assert_allclose(capture.world_T_cam[0, :3, 3], [2, 4, 6])
    back = capture.source_T_world @ [2, 4, 6, 1]
    np.testing.assert_allclose(back, [1, 2, 3, 1])


def test_order_names_and_comments(tmp_path: Path, text: Write) -> None:
    names = ["right/10.png", "right/9.png", "left/10.png", "left/a view.png"]
    for name in names:
        (tmp_path / "images" / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", SIZE).save(tmp_path / "images" / name)
    lines = [
        f"{i} {POSE} 1 {name}\n" + ("\n" if i % 2 else "1 2 -1\n") for i, name in enumerate(names)
    ]
    capture = colmap.read(text(f"# a comment\n\n{PINHOLE}\n", "# another\n" + "".join(lines)))
    assert capture.frames == ["left_10", "left_a view", "right_9", "right_10"]


def test_images_made_smaller_later(text: Write) -> None:
    folder = text("1 PINHOLE 481 360 440 448 244 178")  # by 4, and rounded
    capture = colmap.read(folder)
    sx, sy = 120 / 481, 90 / 360
    expected = [[440 * sx, 0, 244 * sx - 0.5], [0, 448 * sy, 178 * sy - 0.5], [0, 0, 1]]
    np.testing.assert_allclose(capture.K[0], expected)
    assert capture.image(0).shape == (90, 120, 3)
    with pytest.raises(TFLabError, match=r"images are 120x90, their camera 90x120"):
        colmap.read(text("1 PINHOLE 90 120 110 112 44.5 61"))


def test_images_that_cannot_be_used_are_skipped(text: Write) -> None:
    lines = [f"1 {POSE} 1 0.png\n", f"2 {POSE} 1 gone.png\n", f"3 {POSE} 7 1.png\n",
             "4 0 0 0 0 0 0 0 1 1.png\n", "5 nan 0 0 1 0 0 0 1 1.png\n",
             "6 1 0 0 0 0 1e308 0 1 1.png\n"]  # fmt: skip
    capture = colmap.read(text(images="\n".join(lines), count=2))
    assert capture.frames == ["0"]
    assert len(capture.skipped) == 5
    for reason in ("gone.png: no such image", "1.png: its camera 7", "quaternion of zeros", "NaN",
                   "impossibly far"):  # fmt: skip
        assert reason in "\n".join(capture.skipped)


def test_images_without_a_pose_are_counted(text: Write) -> None:
    """Where COLMAP could not place all images, the others are told."""
    capture = colmap.read(text(images=f"1 {POSE} 1 0.png\n\n2 {POSE} 1 2.png\n\n", count=4))
    assert capture.frames == ["0", "2"]
    assert capture.skipped == [
        f"{i}.png: not in the model (COLMAP found no pose for it)" for i in (1, 3)
    ]


@pytest.mark.parametrize(
    "camera", ["2 FOV 120 90 1 1 1 1 1", "2 PINHOLE 120 90 3 -3 61 44.5"]
)  # an unknown lens, an impossible one
def test_a_camera_that_cannot_be_used_costs_its_own_images(text: Write, camera: str) -> None:
    images = f"1 {POSE} 1 0.png\n\n2 {POSE} 2 1.png\n\n"
    capture = colmap.read(text(f"{camera}\n{PINHOLE}\n", images, count=2))
    assert capture.frames == ["0"]
    assert len(capture.skipped) == 1 and capture.skipped[0].startswith("1.png: line 1: ")
    alone = colmap.read(text(f"{camera}\n{PINHOLE}\n", f"1 {POSE} 1 0.png\n\n"))
    assert alone.frames == ["0"]


def test_binary_cameras_after_one_of_an_unknown_lens(binary: Write) -> None:
    folder = binary()
    known = (folder / "cameras.bin").read_bytes()[8:]  # of one camera
    unknown = struct.pack("<IiQQ5d", 9, 7, 120, 90, *[1.0] * 5)
    (folder / "cameras.bin").write_bytes(struct.pack("<Q", 2) + unknown + known)
    assert colmap.read(folder).frames == ["0"]


def test_a_senseless_lens_costs_its_own_images(text: Write) -> None:
    cameras = f"{PINHOLE}\n2 SIMPLE_RADIAL 120 90 110 61 44.5 -4\n"
    capture = colmap.read(text(cameras, f"1 {POSE} 1 0.png\n\n2 {POSE} 2 1.png\n\n", count=2))
    assert capture.frames == ["0"]
    assert len(capture.skipped) == 1 and "1: the lens distortion" in capture.skipped[0]
    with pytest.raises(TFLabError, match="the lens distortion"):
        colmap.read(text(cameras, f"1 {POSE} 2 1.png\n\n", count=2))


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        ("1 PINHOLE 120 90 110 112 61", "line 1: a PINHOLE camera has 3 parameters, not 4"),
        ("1 PINHOLE 120 90 110 112 61 x", "line 1: could not convert"),
        ("\n1 PINHOLE", "line 2: not enough values"),
        ("1 PINHOLE 120 90 110 -112 61 44.5", "must be positive"),
        ("1 PINHOLE 120 90 nan 112 61 44.5", "NaN or infinity"),
        (f"1 PINHOLE {10**30} 90 110 112 61 44.5", "impossible"),
        (f"1 PINHOLE {'9' * 9999} 90 110 112 61 44.5", "line 1"),
        ("\udcff", "utf-8"),
    ],
)
def test_damaged_camera_texts(text: Write, cameras: str, message: str) -> None:
    folder = text()
    (folder / "cameras.txt").write_text(cameras, errors="surrogateescape")
    with pytest.raises(TFLabError, match=message) as error:
        colmap.read(folder)
    assert "cameras.txt" in str(error.value)


@pytest.mark.parametrize(
    ("images", "message"),
    [
        ("1 0 0 0", "line 1: '1 0 0 0' is no image"),
        (f"1 {POSE} 1\n", "is no image"),
        (f"1 {POSE} one 0.png\n", "is no image"),
        (
            f"1 {POSE} 1 0.png\n1 {POSE} 1 1.png\n",
            "line 2: the line of the image's points",
        ),
        ("", "no usable frame"),
    ],
)
def test_damaged_image_texts(text: Write, images: str, message: str) -> None:
    with pytest.raises(TFLabError, match=message):
        colmap.read(text(images=images))


def test_truncated_binaries(binary: Write) -> None:
    folder = binary()
    for name in ("cameras.bin", "images.bin"):
        whole = (folder / name).read_bytes()
        for length in range(0, len(whole), 3):
            (folder / name).write_bytes(whole[:length])
            with pytest.raises(TFLabError, match=name):
                colmap.read(folder)
        (folder / name).write_bytes(whole)
    assert colmap.read(folder).frames == ["0"]


@pytest.mark.parametrize("count", [2**64 - 1, 2**40, 2])
def test_counts_larger_than_the_file(binary: Write, count: int) -> None:
    folder = binary()
    for name, offset in (("cameras.bin", 0), ("images.bin", 0), ("images.bin", 78)):
        content = (folder / name).read_bytes()
        changed = content[:offset] + struct.pack("<Q", count) + content[offset + 8 :]
        (folder / name).write_bytes(changed)
        with pytest.raises(TFLabError, match=f"{name}: it (cannot hold|ends too early)"):
            colmap.read(folder)
        (folder / name).write_bytes(content)


def test_binary_names_that_are_no_text(binary: Write) -> None:
    folder = binary()
    content = (folder / "images.bin").read_bytes()
    (folder / "images.bin").write_bytes(content.replace(b"0.png", b"\xff.png"))
    with pytest.raises(TFLabError, match=r"no usable frame.*no such image"):
        colmap.read(folder)


def test_missing_parts(tmp_path: Path, text: Write) -> None:
    with pytest.raises(TFLabError, match="no sparse model"):
        open_capture(tmp_path, ReadSettings(format="colmap"))
    folder = text()
    (folder / "images" / "0.png").unlink()
    with pytest.raises(TFLabError, match=r"no usable frame.*no such image"):
        colmap.read(folder)
    (folder / "images").rmdir()
    with pytest.raises(TFLabError, match="no folder of images"):
        colmap.read(folder)
