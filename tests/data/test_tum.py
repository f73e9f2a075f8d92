"""TUM RGB-D: which image gets which pose and depth, and the published cameras."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tf_lab.data.capture import Capture
from tf_lab.data.readers import open_capture
from tf_lab.data.reading import ReadSettings
from tf_lab.errors import TFLabError

SIZE = (16, 12)
K = np.array([[15.0, 0, 7.5], [0, 16.0, 5.25], [0, 0, 1]])


def write(
    folder: Path,
    colors: Sequence[float] = (),
    poses: Sequence[float] = (),
    depths: Sequence[float] = (),
) -> Path:
    """A sequence; pose i is at x = i, depth map i is (i + 1) metres everywhere."""
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    np.savetxt(folder / "camera-intrinsics.txt", K)
    for i, time in enumerate(colors):
        Image.new("RGB", SIZE, (i, 0, 0)).save(folder / "rgb" / f"{time:.6f}.png")
    for i, time in enumerate(depths):
        values = np.full(SIZE[::-1], 5000 * (i + 1), np.uint16)
        Image.fromarray(values).save(folder / "depth" / f"{time:.6f}.png")
    for name, times in (("rgb", colors), ("depth", depths)):
        lines = [f"{time:.6f} {name}/{time:.6f}.png\n" for time in times]
        (folder / f"{name}.txt").write_text("# timestamp filename\n" + "".join(lines))
    lines = [f"{time:.4f} {i} 0 0 0 0 0 1\n" for i, time in enumerate(poses)]
    (folder / "groundtruth.txt").write_text("# timestamp tx ty tz qx qy qz qw\n" + "".join(lines))
    return folder


def positions(folder: Path) -> list[float]:
    return list(open_capture(folder).world_T_cam[:, 0, 3])


def test_the_nearest_pose_is_taken(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", [1.0, 1.033, 1.066], [0.99, 1.004, 1.02, 1.031, 1.04, 1.075])
    assert positions(folder) == [1, 3, 5]


def test_lists_that_were_written_on_windows(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", [1.0, 2.0], [1.0, 2.0], [1.0, 2.0])
    for name in ("rgb.txt", "depth.txt"):
        (folder / name).write_text((folder / name).read_text().replace("/", "\\"))
    capture = open_capture(folder)
    depth = capture.depth(1)
    assert capture.frames == ["1.000000", "2.000000"] and depth is not None and (depth == 2).all()


def test_timestamps_in_nanoseconds_are_told(tmp_path: Path) -> None:
    start = 1_693_224_432_000_000_000
    folder = write(tmp_path / "a", [start], [start + 1_000_000])  # 1 ms apart
    with pytest.raises(TFLabError, match=r"groundtruth\.txt: \d+ is no timestamp in seconds"):
        open_capture(folder)


def test_a_pose_too_far_away_does_not_count(tmp_path: Path) -> None:
    times = [1.0, 1.5, 2.0, 2.5]
    folder = write(tmp_path / "a", times, [1.02, 1.5201, 1.98, 2.4799])
    capture = open_capture(folder)
    assert capture.frames == ["1.000000", "2.000000"]  # 0.02 s is near enough
    assert capture.skipped == [f"{time:.6f}: no pose within 0.02 s" for time in (1.5, 2.5)]
    assert positions(folder) == [0, 2]


def test_depth_is_the_nearest_too_and_optional(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", [1.0, 1.5, 2.0], [1.0, 1.5, 2.0], [0.97, 0.99, 1.019, 1.481])
    capture = open_capture(folder)
    first, second, third = (capture.depth(i) for i in range(3))
    assert first is not None and second is not None
    assert (first == 2).all() and (second == 4).all()
    assert third is None
    (folder / "depth" / "0.990000.png").unlink()
    assert open_capture(folder).depth(0) is None
    (folder / "depth.txt").unlink()
    assert open_capture(folder).depth(1) is None


def test_lines_in_any_order_with_comments_and_blanks(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", [1.0, 1.5, 2.0], [1.0, 1.5, 2.0])
    for name in ("rgb.txt", "groundtruth.txt"):
        lines = (folder / name).read_text().splitlines()
        (folder / name).write_text("\r\n\r\n  # more\r\n".join(lines[::-1]) + "\r\n")
    capture = open_capture(folder)
    assert capture.frames == ["1.000000", "1.500000", "2.000000"]
    assert positions(folder) == [0, 1, 2]
    assert [capture.image(i)[0, 0, 0] for i in range(3)] == [0, 1, 2]


def test_the_order_of_a_pose_s_numbers(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", [1.0])
    rotation = Rotation.from_rotvec([0.3, -0.5, 0.2])
    x, y, z, w = rotation.as_quat()
    (folder / "groundtruth.txt").write_text(f"1 1.5 2.5 -3 {x} {y} {z} {w}\n")
    capture = open_capture(folder)
    np.testing.assert_allclose(capture.world_T_cam[0, :3, :3], rotation.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(capture.world_T_cam[0, :3, 3], [1.5, 2.5, -3])
    np.testing.assert_array_equal(capture.source_T_world, np.eye(4))  # its z points up


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        ("0 0 0 0 0 0 0", "no rotation"),
        ("nan 0 0 0 0 0 1", "NaN or infinity"),
        ("0 0 0 0 0 inf 1", "NaN or infinity"),
        ("0 0 x 0 0 0 1", "could not convert"),
    ],
)
def test_an_impossible_pose_skips_the_image(tmp_path: Path, pose: str, reason: str) -> None:
    folder = write(tmp_path / "a", [1.0, 2.0], [1.0])
    with (folder / "groundtruth.txt").open("a") as file:
        file.write(f"2.0 {pose}\n")
    capture = open_capture(folder)
    assert capture.frames == ["1.000000"]
    assert len(capture.skipped) == 1
    assert capture.skipped[0].startswith("2.000000: ") and reason in capture.skipped[0]


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt", "groundtruth.txt"])
@pytest.mark.parametrize("line", ["1.0", "x rgb/1.png", "nan a b c d e f g", "inf a", "1 2 3 4 5"])
def test_a_bad_line_is_named(tmp_path: Path, name: str, line: str) -> None:
    folder = write(tmp_path / "a", [1.0], [1.0], [1.0])
    with (folder / name).open("a") as file:
        file.write(line + "\n")
    if line == "1 2 3 4 5" and name != "groundtruth.txt":  # a file name may have blanks
        assert len(open_capture(folder).frames) == 1
        return
    with pytest.raises(TFLabError, match=rf"{name}, line 3: .*a line holds: timestamp"):
        open_capture(folder)


def test_images_that_are_not_there_or_listed_twice(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", [1.0, 2.0], [1.0, 2.0, 3.0])
    with (folder / "rgb.txt").open("a") as file:
        file.write("3.0 rgb/1.000000.png\n3.0 rgb/none.png\n3.0 rgb/a\0b.png\n")
        file.write(f"3.0 rgb/{'long' * 100}.png\n")
    capture = open_capture(folder)
    assert capture.frames == ["1.000000", "2.000000"]
    assert len(capture.skipped) == 4
    assert capture.skipped[0] == "1.000000: a second image of that name"
    assert all("no such image" in reason for reason in capture.skipped[1:])


def test_missing_lists(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", [1.0], [1.0])
    (folder / "groundtruth.txt").unlink()
    with pytest.raises(TFLabError, match=r"no camera poses.*format=NAME says which"):
        open_capture(folder)
    with pytest.raises(TFLabError, match=r"groundtruth\.txt: missing; .*tx ty tz qx qy qz qw"):
        open_capture(folder, ReadSettings(format="tum"))
    (folder / "groundtruth.txt").write_text("")
    with pytest.raises(TFLabError, match=r"no usable frame.*1\.000000: no pose within"):
        open_capture(folder)
    (folder / "rgb.txt").unlink()
    with pytest.raises(TFLabError, match=r"rgb\.txt: missing"):
        open_capture(folder, ReadSettings(format="tum"))


def vga(folder: Path, image: np.ndarray, depth: np.ndarray | None = None) -> Path:
    """A sequence of one 640x480 image, whose camera only the folder's name tells."""
    folder = write(folder, [1.0], [1.0], [] if depth is None else [1.0])
    (folder / "camera-intrinsics.txt").unlink()
    Image.fromarray(image).save(folder / "rgb" / "1.000000.png")
    if depth is not None:
        Image.fromarray(np.round(depth * 5000).astype(np.uint16)).save(
            folder / "depth" / "1.000000.png"
        )
    return folder


BLACK = np.zeros((480, 640, 3), np.uint8)
# as the benchmark publishes them: fx fy cx cy and the distortion k1 k2 p1 p2 k3
PUBLISHED = {
    "freiburg1": ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": ((535.4, 539.2, 320.1, 247.6), (0.0, 0.0, 0.0, 0.0, 0.0)),
}


def distorted(x: np.ndarray, y: np.ndarray, d: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Where a lens moves normalised coordinates: radial and tangential distortion."""
    r2 = x * x + y * y
    radial = 1 + d[0] * r2 + d[1] * r2**2 + d[4] * r2**3
    return (
        x * radial + 2 * d[2] * x * y + d[3] * (r2 + 2 * x * x),
        y * radial + d[2] * (r2 + 2 * y * y) + 2 * d[3] * x * y,
    )


GRID = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.38, 0.38, 7))  # slopes x / z, y / z
COLUMNS, ROWS = np.meshgrid(np.arange(640), np.arange(480))


def dots(name: str) -> tuple[np.ndarray, np.ndarray]:
    """What a published camera sees of dots at the slopes of `GRID`, dot i in 1 + i / 10 metres."""
    (fx, fy, cx, cy), lens = PUBLISHED[name]
    u, v = distorted(*GRID, lens)
    image, depth = np.zeros((480, 640)), np.zeros((480, 640))
    for i, (x, y) in enumerate(zip((u * fx + cx).ravel(), (v * fy + cy).ravel(), strict=True)):
        near = (COLUMNS - x) ** 2 + (ROWS - y) ** 2
        image += 250 * np.exp(-near / 8)
        depth[near < 25] = 1 + i / 10
    return image.round().astype(np.uint8)[..., None].repeat(3, -1), depth


def dots_off(capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    """How far the dots are from where the camera has them (pixels), and in depth (metres)."""
    image, depth, K = capture.image(0)[..., 0] / 250, capture.depth(0), capture.K[0]
    assert depth is not None
    pixels, metres = [], []
    for i, (x, y) in enumerate(zip(*(slopes.ravel() for slopes in GRID), strict=True)):
        column, row = x * K[0, 0] + K[0, 2], y * K[1, 1] + K[1, 2]
        if not (20 < column < 619 and 20 < row < 459):
            continue
        weight = image * ((COLUMNS - column) ** 2 + (ROWS - row) ** 2 < 25**2)
        centre = np.array([(weight * COLUMNS).sum(), (weight * ROWS).sum()]) / weight.sum()
        pixels.append(np.hypot(*(centre - [column, row])))
        metres.append(abs(depth[round(centre[1]), round(centre[0])] - (1 + i / 10)))
    assert len(pixels) > 30
    return np.array(pixels), np.array(metres)


@pytest.mark.parametrize("name", list(PUBLISHED))
def test_images_and_depth_of_a_known_camera_lose_their_distortion(
    tmp_path: Path, name: str
) -> None:
    """Depth has 5000 units a metre for all: the sensors' corrections of 3 % would be 3 cm here."""
    rgb, depth = dots(name)
    capture = open_capture(vga(tmp_path / f"rgbd_dataset_{name}_desk", rgb, depth))
    assert capture.size == (640, 480)
    pixels, metres = dots_off(capture)
    assert pixels.max() < 0.2
    assert metres.max() < 1e-3
    if name == "freiburg3":
        (fx, fy, cx, cy), _ = PUBLISHED[name]
        np.testing.assert_array_equal(capture.image(0), rgb)
        np.testing.assert_allclose(capture.K[0], [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def test_a_link_may_say_the_camera(tmp_path: Path) -> None:
    real = vga(tmp_path / "download", *dots("freiburg2"))
    (tmp_path / "rgbd_dataset_freiburg2_desk").symlink_to(real)
    pixels, _ = dots_off(open_capture(tmp_path / "rgbd_dataset_freiburg2_desk"))
    assert pixels.max() < 0.2


@pytest.mark.parametrize("name", list(PUBLISHED))
def test_another_camera_would_show(tmp_path: Path, name: str) -> None:
    rgb, depth = dots(name)
    for other in set(PUBLISHED) - {name}:
        pixels, _ = dots_off(open_capture(vga(tmp_path / other, rgb, depth)))
        assert np.median(pixels) > 3
    folder = vga(tmp_path / "uncalibrated", rgb, depth)
    np.savetxt(folder / "K.txt", [[525, 0, 319.5], [0, 525, 239.5], [0, 0, 1]])
    pixels, _ = dots_off(open_capture(folder))
    assert np.median(pixels) > 3


def paired(folder: Path, lines: Sequence[str]) -> Path:
    """The images listed in associations.txt instead of rgb.txt and depth.txt."""
    (folder / "associations.txt").write_text("# rgb and depth\n" + "\n".join(lines) + "\n")
    for name in ("rgb.txt", "depth.txt"):
        (folder / name).unlink()
    return folder


@pytest.mark.parametrize("depth_first", [False, True])
def test_associations(tmp_path: Path, depth_first: bool) -> None:
    folder = write(tmp_path / "a", [1.0, 2.0, 3.0], [1.01, 2.01, 9.0], [1.5, 2.5])
    color = [f"{t:.6f} rgb/{t:.6f}.png" for t in (1.0, 2.0, 3.0)]
    depth = ["1.500000 depth/1.500000.png", "2.500000 depth/2.500000.png", "3.5 depth/none.png"]
    pairs = [(d, c) if depth_first else (c, d) for c, d in zip(color, depth, strict=True)]
    capture = open_capture(paired(folder, [" ".join(pair) for pair in pairs]))
    assert capture.frames == ["1.000000", "2.000000"]
    assert capture.skipped == ["3.000000: no pose within 0.02 s"]  # of the colour image's time
    assert positions(folder) == [0, 1]
    for i in range(2):  # however far apart their times are
        found = capture.depth(i)
        assert found is not None and (found == i + 1).all()
        assert capture.image(i)[0, 0, 0] == i


@pytest.mark.parametrize("depth_first", [False, True])
def test_associations_with_more_columns(tmp_path: Path, depth_first: bool) -> None:
    """As they come of the benchmark's script, run a second time for the poses."""
    folder = write(tmp_path / "a", [1.0, 2.0], [1.0, 2.0], [1.0, 2.0])
    lines = []
    for t in (1.0, 2.0):
        pair = [f"{t:.6f} rgb/{t:.6f}.png", f"{t:.6f} depth/{t:.6f}.png"]
        lines.append(
            " ".join(pair[::-1] if depth_first else pair) + f" {t:.6f} 1.3 0.6 1.6 0 0 0 1"
        )
    capture = open_capture(paired(folder, lines))
    assert capture.frames == ["1.000000", "2.000000"]
    assert all(capture.depth(i) is not None for i in range(2))


@pytest.mark.parametrize("line", ["1.0 rgb/1.png", "1.0 depth/1.png x rgb/1.png"])
def test_a_bad_line_of_associations(tmp_path: Path, line: str) -> None:
    folder = paired(write(tmp_path / "a", [1.0], [1.0], [1.0]), [line])
    with pytest.raises(TFLabError, match=r"associations\.txt"):
        open_capture(folder)


def test_the_user_s_camera_wins(tmp_path: Path) -> None:
    folder = vga(tmp_path / "rgbd_dataset_freiburg1_xyz", BLACK)
    np.savetxt(folder / "K.txt", [[500, 0, 320], [0, 510, 240], [0, 0, 1]])
    np.testing.assert_array_equal(open_capture(folder).K[0, [0, 1], [0, 1]], [500, 510])


def test_an_unknown_camera(tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match=r"camera is unknown.*camera-intrinsics\.txt or K\.txt"):
        open_capture(vga(tmp_path / "sequence", BLACK))
    with pytest.raises(TFLabError, match=r"images are 320x240, those of freiburg2 640x480"):
        open_capture(vga(tmp_path / "freiburg2", BLACK[:240, :320]))
