"""Captures with a known fault, and without: what the check says of them."""

from dataclasses import replace
from functools import lru_cache
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.injections import INJECTIONS, Frames, opened, source_of
from helpers.layouts import LAYOUTS
from tf_lab.data.diagnosis import diagnose, quick_warning
from tf_lab.data.diagnosis.alternatives import of_intrinsics
from tf_lab.data.diagnosis.evidence import Evidence
from tf_lab.data.diagnosis.matches import Pair, sampson_pixels
from tf_lab.data.diagnosis.verdict import DOUBTFUL, FINE, UNKNOWN, WRONG, Report
from tf_lab.data.lens import Camera
from tf_lab.data.readers import as_read, open_capture
from tf_lab.data.readers.source import (
    ColorFile,
    DepthFile,
    SourceCapture,
    SourceFrame,
    collect,
)
from tf_lab.data.reading import AS_STATED, ReadSettings
from tf_lab.data.rooms import RoomSettings, generate_room
from tf_lab.data.scene import Frame
from tf_lab.errors import TFLabError

DOWN = ReadSettings(gravity=(0.0, 0.0, -1.0))
SIZE, FOCAL = (160, 120), 130.0
COUNT = 9
K = np.array([[FOCAL, 0, 79.5], [0, FOCAL, 59.5], [0, 0, 1.0]])


@lru_cache(maxsize=1)
def room() -> tuple[Frame, ...]:
    """Neighbouring views of a test room, as many as a check needs."""
    settings = RoomSettings(width=160, height=120, frames=60, samples=1)
    return tuple(islice(generate_room(3, settings), 24))


def checked(frames: Frames, quaternions: str | None = None) -> Report:
    return diagnose(opened(frames, DOWN, quaternions), DOWN, Path("made up"))[0]


# --- the geometry, against points that are known --------------------------------------------------


def poses() -> list[np.ndarray]:
    """A walk along an arc, looking at what lies ahead and turning."""
    found = []
    for i in range(COUNT):
        yaw, pitch, roll = 0.05 * i, 0.02 * i * (-1) ** i, 0.03 * i
        cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (np.cos, np.sin))
        pose = np.eye(4)
        pose[:3, :3] = (
            np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
            @ np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
            @ np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
        )
        pose[:3, 3] = [0.1 * i, 0.02 * i * i, 0.05 * i]
        found.append(pose)
    return found


def seen(pose: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [N, 2] and depths [N] of points."""
    camera = (points - pose[:3, 3]) @ pose[:3, :3]
    return (camera @ K.T)[:, :2] / camera[:, 2:], camera[:, 2]


def exact_evidence() -> tuple[Evidence, list[np.ndarray]]:
    """Matches without any error, and the depths of the points in each pair's first image."""
    points = np.random.default_rng(0).uniform([-1, -1, 3], [1.5, 1, 5], (40, 3))
    black = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    frames = [Frame(str(i), black, K, pose, None) for i, pose in enumerate(poses())]
    pairs, depths = [], []
    for i in range(COUNT - 1):
        (a, z), (b, _) = seen(poses()[i], points), seen(poses()[i + 1], points)
        pairs.append(Pair(i, i + 1, a, b, 0.0))
        depths.append(z)
    return Evidence(opened(frames, DOWN), DOWN, pairs), depths


def test_exact_matches_have_no_error_and_the_depth_they_have() -> None:
    evidence, depths = exact_evidence()
    geometry = evidence.geometry(DOWN)
    np.testing.assert_allclose(evidence.errors(geometry), 0, atol=1e-9)
    z, _ = evidence.depths(geometry)
    known = np.isfinite(z[:, :40])
    assert known.mean() > 0.3
    np.testing.assert_allclose(z[:, :40][known], np.stack(depths)[known], rtol=1e-6)
    assert evidence.in_front(geometry) == 1


def test_the_sampson_distance_is_that_to_the_nearest_pair_of_points() -> None:
    """Of a camera that moves to the right, lines are rows: half the offset in each image."""
    F = np.array([[0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    a, b = np.array([[10.0, 20.0], [3.0, 4.0]]), np.array([[15.0, 20.0], [9.0, 5.0]])
    np.testing.assert_allclose(sampson_pixels(F, a, b), [0, 1 / np.sqrt(2)], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "zero"),
    [({"turn": 180}, False), ({"axes": "lub"}, True), ({"axes": "opengl"}, False)],
)
def test_what_epipolar_geometry_cannot_tell_depth_does(
    change: dict[str, object], zero: bool
) -> None:
    """Axes of all signs changed have the same epipolar lines, and all points behind them."""
    evidence, _ = exact_evidence()
    geometry = evidence.geometry(replace(DOWN, **change))  # type: ignore[arg-type]
    assert (evidence.errors(geometry).max() < 1e-9) == zero
    if zero:
        assert evidence.in_front(geometry) == 0


# --- rendered captures ----------------------------------------------------------------------------


def test_poses_of_nothing_are_wrong_and_no_setting_is_said_to_mend_them() -> None:
    """In a random order some axes give smaller errors than others, and mend nothing."""
    frames = list(room())
    order = np.random.default_rng(1).permutation(len(frames))
    mixed = [
        replace(f, world_T_cam=frames[i].world_T_cam) for f, i in zip(frames, order, strict=True)
    ]
    report = checked(mixed)
    assert (report.verdict, report.settings) == (WRONG, [])
    assert "do not fit" in report.findings[0]
    assert report.found is not None and report.found.focal is None


def test_poses_without_a_unit_are_asked_for_one() -> None:
    def read(settings: ReadSettings) -> Report:
        source = source_of([replace(f, depth=None) for f in room()])
        source = replace(source, given=replace(source.given, metric=False))
        capture = as_read(source, Path("made up"), settings, strict=False)
        return diagnose(capture, settings, Path("made up"))[0]

    report = read(DOWN)
    assert report.verdict == DOUBTFUL
    assert "give scale=METRES_PER_UNIT" in report.findings[0]
    assert read(replace(DOWN, scale=1.0)).verdict == FINE


@pytest.mark.parametrize("every", [1, 2])
def test_depth_that_cannot_be_read_is_told(every: int) -> None:
    """Whether it is all of it, or every other map, the partner of one that can be read."""

    def damaged() -> np.ndarray:
        raise TFLabError("depth.png: of 8 bits")

    source = source_of(list(room()))
    frames = source.given.frames
    frames = [replace(f, depth=damaged) if i % every == 0 else f for i, f in enumerate(frames)]
    source = replace(source, given=replace(source.given, frames=frames))
    capture = as_read(source, Path("made up"), DOWN, strict=False)
    report = diagnose(capture, DOWN, Path("made up"))[0]
    assert report.verdict == DOUBTFUL
    assert "depth maps are left out: depth.png: of 8 bits" in report.findings


def test_a_right_capture_is_fine() -> None:
    report = checked(list(room()))
    assert (report.verdict, report.settings, report.findings) == (FINE, [], [])
    assert report.found is not None and report.found.focal is not None
    assert report.found.given.error < 0.3
    assert report.found.focal[0] == pytest.approx(1, abs=0.02)
    assert report.scale is not None
    assert report.scale.factor == pytest.approx(1, abs=0.03)
    assert report.sensors is not None
    assert report.sensors.focal == pytest.approx(1, abs=0.03)
    figures = report.statistics
    assert figures is not None
    assert (figures.frames, figures.lost, figures.size) == (24, 0, (160, 120))
    centres = np.stack([f.world_T_cam[:3, 3] for f in room()])
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    assert figures.path == pytest.approx(steps.sum())
    assert figures.height == pytest.approx(np.median(centres[:, 2]), abs=0.1)  # the floor is at 0
    assert figures.field_of_view[0] == pytest.approx(
        np.degrees(2 * np.arctan(80 / room()[0].K[0, 0]))
    )


FEW = ("inverted", "focal x 0.8")


def assert_named(name: str, frames: Frames) -> None:
    injection = INJECTIONS[name]
    report = checked(injection.do(frames), injection.quaternions)
    assert report.verdict == WRONG
    assert injection.names(report.settings, frames), report.settings


@pytest.mark.parametrize("name", FEW)
def test_a_fault_is_named(name: str) -> None:
    assert_named(name, list(room()))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in INJECTIONS if name not in FEW])
def test_every_fault_is_named(name: str) -> None:
    assert_named(name, list(room()))


def test_scannets_images_are_often_made_smaller() -> None:
    """Exports of 640x480 keep the intrinsics of 1296x968, which is no multiple of it."""
    camera = SimpleNamespace(size=(640, 480), cx=647.75, cy=483.75)
    given: Any = SimpleNamespace(frames=[SimpleNamespace(camera=camera)])
    found = [a.settings.intrinsics_size for a in of_intrinsics(AS_STATED, given)]
    assert found[:2] == [(1280, 960), (1296, 968)]
    camera.size = (648, 484)  # half of it: named once
    found = [a.settings.intrinsics_size for a in of_intrinsics(AS_STATED, given)]
    assert found.count((1296, 968)) == 1


def test_a_quick_check_warns_in_a_line() -> None:
    frames = list(room())
    assert quick_warning(opened(frames, DOWN), DOWN) is None
    wrong = INJECTIONS["opengl"].do(frames)
    line = quick_warning(opened(wrong, DOWN), DOWN)
    assert line is not None
    assert "axes=opengl" in line
    assert "\n" not in line


def test_a_quick_check_never_fails(tmp_path: Path) -> None:
    """Depth in another unit, whose first map is damaged; a focal length as short as can be."""
    module = LAYOUTS["plain"]
    frames = [replace(frame, depth=frame.depth / 5) for frame in room()]
    folder = module.write(tmp_path / "room", frames)
    depth = sorted((folder / "depth").iterdir())[0]
    depth.write_bytes(depth.read_bytes()[:50])
    line = quick_warning(open_capture(folder, module.OPTIONS), module.OPTIONS)
    assert line is not None
    assert "depth_scale=200" in line
    short = [
        replace(frame, K=frame.K * [[0.055 * 160 / 130], [0.055 * 160 / 130], [1]])
        for frame in room()
    ]
    for frame, true in zip(short, room(), strict=True):
        frame.K[:2, 2] = true.K[:2, 2]
    line = quick_warning(opened(short, DOWN), DOWN)
    assert line is not None
    assert "focal_scale" in line or "do not fit" in line


def test_without_texture_nothing_is_guessed() -> None:
    grey = [replace(f, image=np.full_like(f.image, 128)) for f in room()]
    report = checked(INJECTIONS["inverted"].do(grey))
    assert (report.verdict, report.settings) == (UNKNOWN, [])
    assert "too little texture" in report.findings[0]
    assert quick_warning(opened(grey, DOWN), DOWN) is None


def test_of_a_single_image_nothing_is_said_of_texture() -> None:
    report = checked(room()[:1])
    assert (report.verdict, report.settings) == (UNKNOWN, [])
    assert report.findings[0] == "a single image says nothing about the cameras"


def test_a_camera_that_stands_still_tells_nothing_of_poses() -> None:
    still = [replace(room()[0], name=str(i)) for i in range(12)]
    report = checked(still)
    assert report.verdict == UNKNOWN
    assert "all 12 poses are the same" in report.findings[0]


def test_poses_that_do_not_move_as_the_images_do_are_wrong() -> None:
    pose = room()[0].world_T_cam
    still = [replace(f, world_T_cam=pose) for f in room()]
    report = checked(still)
    assert (report.verdict, report.settings) == (WRONG, [])
    assert report.findings == ["the camera does not move: all 24 poses are the same"]
    turning = [f.world_T_cam.copy() for f in room()]
    for matrix in turning:
        matrix[:3, 3] = pose[:3, 3]
    at_one_place = [replace(f, world_T_cam=p) for f, p in zip(room(), turning, strict=True)]
    line = quick_warning(opened(at_one_place, DOWN), DOWN)
    assert line is not None
    assert "the camera only turns: all 24 poses are at one place" in line


def test_without_depth_a_wrong_unit_is_doubted() -> None:
    far = INJECTIONS["scale x 1000"].do([replace(f, depth=None) for f in room()])
    report = checked(far)
    assert report.verdict == DOUBTFUL
    assert report.settings == ["scale=0.001"]


@pytest.mark.parametrize(("factor", "mend"), [(0.01, "scale=100"), (100, "scale=0.01")])
def test_a_quick_check_warns_of_a_wrong_unit(factor: float, mend: str) -> None:
    poses = [f.world_T_cam.copy() for f in room()]
    for pose in poses:
        pose[:3, 3] *= factor
    frames = [replace(f, depth=None, world_T_cam=p) for f, p in zip(room(), poses, strict=True)]
    line = quick_warning(opened(frames, DOWN), DOWN)
    assert line is not None
    assert f"which no room has in metres; try {mend}" in line
    grey = [replace(f, image=np.full_like(f.image, 128)) for f in frames]
    line = quick_warning(opened(grey, DOWN), DOWN)
    assert (line is not None) == (factor < 1)
    assert factor > 1 or "give scale=METRES_PER_UNIT" in str(line)


def forced(folder: Path) -> SourceCapture:
    """The real sequence with the depth camera's focal length for both cameras."""
    camera = Camera((640, 480), 585.0, 585.0, 320.0, 240.0)
    frames = [
        SourceFrame(
            pose.name.split(".")[0],
            camera,
            np.loadtxt(pose),
            ColorFile(pose.with_name(pose.name.replace("pose.txt", "color.jpg"))),
            DepthFile(pose.with_name(pose.name.replace("pose.txt", "depth.png"))),
        )
        for pose in sorted(folder.glob("*.pose.txt"))
    ]
    return as_read(collect(folder, frames, []), folder, AS_STATED)


@pytest.mark.slow
def test_two_sensors_taken_for_one(redkitchen: Path) -> None:
    """The depth camera's focal length taken for colour's (525 of 585: a factor of 0.897)."""
    report, _ = diagnose(forced(redkitchen), AS_STATED, redkitchen)
    assert report.verdict == WRONG
    name, _, value = report.settings[0].partition("=")
    assert name == "focal_scale"
    assert 0.865 < float(value) < 0.905
    assert report.settings[1:] == ["depth_camera=as_given"]
    assert report.sensors is not None
    assert report.sensors.focal == pytest.approx(525 / 585, abs=0.015)
    assert report.sensors.offset[0] == pytest.approx(0.025, abs=0.015)


@pytest.mark.slow
@pytest.mark.parametrize("layout", list(LAYOUTS))
def test_no_layout_is_called_wrong(layout: str, tmp_path: Path) -> None:
    """As read by each reader, a room is as right as it was; small, so that little can be told."""
    module = LAYOUTS[layout]
    path = module.write(tmp_path / "room", room())
    report, _ = diagnose(open_capture(path, module.OPTIONS), module.OPTIONS, path)
    assert report.verdict == FINE, report.findings


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20, 30))
def test_no_room_is_called_wrong(seed: int) -> None:
    report = checked(list(generate_room(seed, RoomSettings(frames=60))))
    assert report.verdict == FINE, report.findings
