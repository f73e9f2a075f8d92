"""Every layout gives the same cameras and images, and says what is wrong with a bad one."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tf_lab.data.readers import open_capture
from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame, Scene, write_scene
from tf_lab.errors import TFLabError

SIZE = (16, 12)
K = np.array([[15.0, 0, 7.5], [0, 16.0, 5.25], [0, 0, 1]])
COUNT = 11  # so that natural order (2 before 10) matters
DOWN = [0.1, 0.9, 0.4]


def known_poses() -> np.ndarray:
    random = np.random.default_rng(1)
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(random.uniform(-1, 1, (COUNT, 3))).as_matrix()
    poses[:, :3, 3] = random.uniform(-2, 2, (COUNT, 3))
    return poses


def known_images() -> np.ndarray:
    return np.random.default_rng(2).integers(0, 256, (COUNT, SIZE[1], SIZE[0], 3), np.uint8)


def known_depths() -> np.ndarray:
    depths = np.random.default_rng(3).integers(300, 5000, (COUNT, SIZE[1], SIZE[0]), np.uint16)
    depths[:, 0, 0], depths[:, 0, 1] = 0, 65535
    return depths


def write_seven_scenes(directory: Path) -> None:
    np.savetxt(directory / "camera-intrinsics.txt", K)
    for i, (pose, image, depth) in enumerate(
        zip(known_poses(), known_images(), known_depths(), strict=True)
    ):
        Image.fromarray(image).save(directory / f"frame-{i:06d}.color.png")
        Image.fromarray(depth).save(directory / f"frame-{i:06d}.depth.png")
        np.savetxt(directory / f"frame-{i:06d}.pose.txt", pose, fmt="%.17g")


def write_plain(directory: Path) -> None:
    np.savetxt(directory / "K.txt", K)
    np.savetxt(directory / "poses.txt", known_poses().reshape(COUNT, 16), fmt="%.17g")
    (directory / "images").mkdir()
    (directory / "depth").mkdir()
    for i, (image, depth) in enumerate(zip(known_images(), known_depths(), strict=True)):
        Image.fromarray(image).save(directory / "images" / f"{i}.png")
        Image.fromarray(depth).save(directory / "depth" / f"{i}.png")


WRITERS = {"seven_scenes": write_seven_scenes, "plain": write_plain}
layouts = pytest.mark.parametrize("layout", list(WRITERS))


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str], Path]:
    """Writes the known capture in a layout and returns its directory."""

    def write(layout: str) -> Path:
        directory = tmp_path / layout
        directory.mkdir()
        WRITERS[layout](directory)
        return directory

    return write


def rewrite_line(path: Path, number: int, text: str) -> None:
    lines = path.read_text().splitlines()
    lines[number - 1] = text
    path.write_text("\n".join(lines) + "\n")


@layouts
@pytest.mark.parametrize("named", [True, False])
def test_every_layout_gives_the_known_capture(
    written: Callable[[str], Path], layout: str, named: bool
) -> None:
    capture = open_capture(
        written(layout), ReadSettings(format=layout if named else None, gravity=DOWN)
    )
    assert (capture.name, capture.size, capture.skipped) == (layout, SIZE, [])
    assert len(capture.frames) == len(set(capture.frames)) == COUNT
    np.testing.assert_array_equal(capture.K, np.tile(K, (COUNT, 1, 1)))
    back = capture.source_T_world @ capture.world_T_cam
    np.testing.assert_allclose(back, known_poses(), atol=1e-9)
    up = capture.source_T_world[:3, :3] @ [0, 0, 1]
    np.testing.assert_allclose(up, -np.array(DOWN) / np.linalg.norm(DOWN), atol=1e-9)
    for i in range(COUNT):
        np.testing.assert_array_equal(capture.image(i), known_images()[i])
        depth = capture.depth(i)
        assert depth is not None
        assert depth[0, 0] == depth[0, 1] == 0  # no reading
        np.testing.assert_allclose(depth[1:], known_depths()[i, 1:] / 1000, atol=1e-6)


@layouts
def test_depth_is_optional(written: Callable[[str], Path], layout: str) -> None:
    directory = written(layout)
    for path in [*directory.glob("*.depth.png"), *directory.glob("depth/*")]:
        path.unlink()
    assert open_capture(directory, ReadSettings(gravity=DOWN)).depth(0) is None


def test_plain_poses_of_twelve_numbers_and_a_blank_last_line(
    written: Callable[[str], Path],
) -> None:
    directory = written("plain")
    expected = open_capture(directory, ReadSettings(gravity=DOWN)).world_T_cam
    np.savetxt(directory / "poses.txt", known_poses()[:, :3].reshape(COUNT, 12), fmt="%.17g")
    with (directory / "poses.txt").open("a") as file:
        file.write("\n")
    np.testing.assert_array_equal(
        open_capture(directory, ReadSettings(gravity=DOWN)).world_T_cam, expected
    )


def test_a_prepared_scene_opens_too(tmp_path: Path) -> None:
    frames = [Frame("a", known_images()[0], K, np.eye(4))]
    write_scene(tmp_path / "room", frames, {}, "room")
    assert isinstance(open_capture(tmp_path / "room"), Scene)
    with pytest.raises(TFLabError, match="z-up already"):
        open_capture(tmp_path / "room", ReadSettings(gravity=DOWN))


def test_gravity_file_is_found(written: Callable[[str], Path]) -> None:
    directory = written("plain")
    np.savetxt(directory / "gravity-direction.txt", [0, 1, 0])
    capture = open_capture(directory)
    np.testing.assert_allclose(capture.source_T_world[:3, :3] @ [0, 0, -1], [0, 1, 0], atol=1e-12)


LOST = {
    "nan": " ".join(["nan"] * 16),
    "inf": " ".join(["1 0 0 -inf", "0 1 0 0", "0 0 1 0", "0 0 0 1"]),
    "mirrored": "-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1",
    "scaled": "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1",
    "stray": "1 0 0 9000 0 1 0 0 0 0 1 0 0 0 0 1",
}
REASONS = {"nan": "NaN or infinity", "inf": "NaN or infinity", "stray": "off the others"}


@layouts
@pytest.mark.parametrize("kind", list(LOST))
def test_unusable_poses_are_skipped_and_listed(
    written: Callable[[str], Path], layout: str, kind: str
) -> None:
    directory = written(layout)
    if layout == "plain":
        rewrite_line(directory / "poses.txt", 3, LOST[kind])
    else:
        (directory / "frame-000002.pose.txt").write_text(LOST[kind])
    capture = open_capture(directory, ReadSettings(gravity=DOWN))
    name = {"plain": "2", "seven_scenes": "frame-000002"}[layout]
    assert len(capture.frames) == COUNT - 1
    assert name not in capture.frames
    assert len(capture.skipped) == 1
    assert capture.skipped[0].startswith(f"{name}: ")
    assert REASONS.get(kind, "not a rigid") in capture.skipped[0]
    np.testing.assert_array_equal(capture.image(2), known_images()[3])  # images stay with poses


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"1 2 3", "3 values"),
        (b"a " * 16, "could not convert"),
        (b"", "0 values"),
        (None, "missing"),
    ],
)
def test_seven_scenes_bad_pose_file_skips_the_frame(
    written: Callable[[str], Path], content: bytes | None, reason: str
) -> None:
    directory = written("seven_scenes")
    path = directory / "frame-000004.pose.txt"
    path.unlink() if content is None else path.write_bytes(content)
    capture = open_capture(directory, ReadSettings(gravity=DOWN))
    assert len(capture.frames) == COUNT - 1
    assert capture.skipped[0].startswith("frame-000004: ")
    assert reason in capture.skipped[0]


def test_seven_scenes_as_published_has_no_intrinsics_file(
    written: Callable[[str], Path], tmp_path: Path
) -> None:
    directory = tmp_path / "published"
    directory.mkdir()
    for i, pose in enumerate(known_poses()):
        Image.new("RGB", (640, 480)).save(directory / f"frame-{i:06d}.color.png")
        np.savetxt(directory / f"frame-{i:06d}.pose.txt", pose, fmt="%.17g")
    capture = open_capture(directory, ReadSettings(gravity=DOWN))
    np.testing.assert_array_equal(capture.K[0], [[525, 0, 320], [0, 525, 240], [0, 0, 1]])
    other = written("seven_scenes")  # of another size: nothing is assumed
    (other / "camera-intrinsics.txt").unlink()
    with pytest.raises(TFLabError, match=r"camera-intrinsics\.txt: missing"):
        open_capture(other, ReadSettings(gravity=DOWN))


def test_seven_scenes_pose_without_image_is_listed(written: Callable[[str], Path]) -> None:
    directory = written("seven_scenes")
    (directory / "frame-000004.color.png").unlink()
    capture = open_capture(directory, ReadSettings(gravity=DOWN))
    assert capture.skipped == ["frame-000004: no colour image"]
    np.testing.assert_array_equal(capture.image(4), known_images()[5])


@pytest.mark.parametrize("line", ["1 2 3", "x " * 16])
def test_plain_bad_pose_line_is_named(written: Callable[[str], Path], line: str) -> None:
    directory = written("plain")
    rewrite_line(directory / "poses.txt", 7, line)
    with pytest.raises(TFLabError, match=r"poses\.txt, line 7"):
        open_capture(directory)


def test_plain_counts_must_match(written: Callable[[str], Path]) -> None:
    directory = written("plain")
    (directory / "images" / "10.png").unlink()
    with pytest.raises(TFLabError, match=r"poses\.txt has 11 lines, images/ has 10 images"):
        open_capture(directory)


def test_plain_names_must_differ_by_stem(written: Callable[[str], Path]) -> None:
    directory = written("plain")
    (directory / "images" / "10.png").rename(directory / "images" / "9.jpg")
    with pytest.raises(TFLabError, match="two images are called 9"):
        open_capture(directory)


@pytest.mark.parametrize("missing", ["poses.txt", "images", "K.txt"])
def test_plain_missing_part_is_named(written: Callable[[str], Path], missing: str) -> None:
    directory = written("plain")
    (directory / missing).rename(directory / "elsewhere")
    with pytest.raises(TFLabError, match=missing):
        open_capture(directory, ReadSettings(format="plain"))


INTRINSICS = {"plain": "K.txt", "seven_scenes": "camera-intrinsics.txt"}


@layouts
@pytest.mark.parametrize(
    "content",
    [
        "15 0 7.5 0 16 5.25",
        "nan 0 7.5 0 16 5.25 0 0 1",
        "-15 0 7.5 0 16 5.25 0 0 1",
        "0 0 7.5 0 16 5.25 0 0 1",
        "15 0 0 0 16 0 7.5 5.25 1",  # transposed
        "fx 0 7.5 0 16 5.25 0 0 1",
        "",
    ],
)
def test_bad_intrinsics_are_named(
    written: Callable[[str], Path], layout: str, content: str
) -> None:
    directory = written(layout)
    (directory / INTRINSICS[layout]).write_text(content)
    with pytest.raises(TFLabError, match=INTRINSICS[layout]):
        open_capture(directory)


@layouts
def test_no_usable_frame(written: Callable[[str], Path], layout: str) -> None:
    directory = written(layout)
    for path in [*directory.glob("*.pose.txt"), *directory.glob("poses.txt")]:
        lost = LOST["nan"] + "\n"
        path.write_text(lost * COUNT if layout == "plain" else lost)
    with pytest.raises(TFLabError, match=r"no usable frame.*all 11.*NaN"):
        open_capture(directory)


def colour_files(directory: Path) -> list[Path]:
    return sorted([*directory.glob("*.color.png"), *directory.glob("images/*.png")])


@layouts
def test_damaged_images_are_found_when_asked_for(
    written: Callable[[str], Path], layout: str
) -> None:
    directory = written(layout)
    first = colour_files(directory)[0]
    first.write_bytes(first.read_bytes()[:60])
    capture = open_capture(directory, ReadSettings(gravity=DOWN))
    with pytest.raises(TFLabError, match=first.name):
        capture.image(0)
    np.testing.assert_array_equal(capture.image(1), known_images()[1])


@layouts
def test_an_empty_first_image_does_not_hide_the_size(
    written: Callable[[str], Path], layout: str
) -> None:
    directory = written(layout)
    colour_files(directory)[0].write_bytes(b"")
    assert open_capture(directory, ReadSettings(gravity=DOWN)).size == SIZE


@layouts
def test_no_readable_image(written: Callable[[str], Path], layout: str) -> None:
    directory = written(layout)
    for path in colour_files(directory):
        path.write_bytes(b"not an image")
    with pytest.raises(TFLabError, match="not one of the colour images can be read"):
        open_capture(directory)


@layouts
def test_images_of_another_size_are_told(written: Callable[[str], Path], layout: str) -> None:
    directory = written(layout)
    odd = colour_files(directory)[-1]
    Image.new("RGB", (8, 6)).save(odd)
    capture = open_capture(directory, ReadSettings(gravity=DOWN))
    index = [Path(str(f.color)).name for f in capture.source].index(odd.name)  # type: ignore[attr-defined]
    with pytest.raises(TFLabError, match="is 8x6, its camera 16x12"):
        capture.image(index)


def test_missing_empty_and_unknown_folders(tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match=r"no such folder or file"):
        open_capture(tmp_path / "nowhere")
    with pytest.raises(
        TFLabError, match=rf"{tmp_path}: empty; .* simplest as images/, poses.txt, K.txt$"
    ):
        open_capture(tmp_path)
    (tmp_path / "notes.md").write_text("")
    with pytest.raises(TFLabError, match=r"no known layout.*seven_scenes.*plain"):
        open_capture(tmp_path)
    with pytest.raises(TFLabError, match=r"images: no JPEG or PNG"):
        open_capture(tmp_path, ReadSettings(format="plain"))
    with pytest.raises(TFLabError, match=r"no frame-XXXXXX"):
        open_capture(tmp_path, ReadSettings(format="seven_scenes"))
    with pytest.raises(TFLabError, match=r"format=colmapp.*known are scene, seven_scenes, plain"):
        open_capture(tmp_path, ReadSettings(format="colmapp"))
    with pytest.raises(TFLabError, match=r"scene\.json"):
        open_capture(tmp_path, ReadSettings(format="scene"))


def test_two_layouts_in_one_folder_need_a_choice(tmp_path: Path) -> None:
    write_plain(tmp_path)
    write_seven_scenes(tmp_path)
    with pytest.raises(TFLabError, match=r"seven_scenes or plain.*format="):
        open_capture(tmp_path)
    assert open_capture(tmp_path, ReadSettings(format="plain", gravity=DOWN)).frames[0] == "0"


def test_poses_beside_images_that_are_not_where_they_belong(tmp_path: Path) -> None:
    write_plain(tmp_path)
    for file in (tmp_path / "images").iterdir():
        file.rename(tmp_path / file.name)
    (tmp_path / "images").rmdir()
    with pytest.raises(TFLabError, match=r"images and poses\.txt, .*; put the images in images/"):
        open_capture(tmp_path)


@pytest.mark.parametrize(
    ("mistake", "told"),
    [(lambda poses: poses.swapaxes(1, 2), "column by column: transpose"),
     (lambda poses: poses * [[[1], [1], [-1], [1]]], "an axis is mirrored")],
)  # fmt: skip
def test_matrices_that_are_no_poses_are_told_apart(
    tmp_path: Path, mistake: Callable[[np.ndarray], np.ndarray], told: str
) -> None:
    write_plain(tmp_path)
    poses = known_poses()
    poses[:, :3, 3] += 1
    np.savetxt(tmp_path / "poses.txt", mistake(poses).reshape(len(poses), 16))
    with pytest.raises(TFLabError, match=told):
        open_capture(tmp_path)
