"""What the C++ SensReader writes: both cameras, the unit of depth, and damage."""

from pathlib import Path

import numpy as np
import pytest

from helpers.layouts import room_frames, sensreader as layout
from tf_lab.data.readers import detect_format, open_capture, sensreader
from tf_lab.errors import TFLabError

FRAMES = room_frames()[:3]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return layout.write(tmp_path / "scene0000_00", FRAMES)


def test_frames(folder: Path) -> None:
    assert detect_format(folder) == ["sensreader"]
    (folder / "frame-000000.pose.txt").write_text("-inf " * 16)
    (folder / "frame-000001.depth.pgm").unlink()
    capture = sensreader.read(folder)
    assert capture.frames == ["frame-000001", "frame-000002"]
    assert capture.skipped == ["frame-000000: the pose has NaN or infinity (frame lost)"]
    assert capture.depth(0) is None
    np.testing.assert_allclose(capture.depth(1), FRAMES[2].depth, atol=2e-4)
    assert capture.down == (0, 0, -1)
    (folder / "frame-000001.pose.txt").unlink()
    assert sensreader.read(folder).frames == ["frame-000002"]


def test_a_scan_without_depth(folder: Path) -> None:
    info = (folder / "_info.txt").read_text()
    info = info.replace("m_depthWidth = 96", "m_depthWidth = 0")
    (folder / "_info.txt").write_text(info.replace("m_depthHeight = 72", "m_depthHeight = 0"))
    assert sensreader.read(folder).depth(0) is None


@pytest.mark.parametrize(
    ("line", "instead", "message"),
    [
        ("m_depthShift = 4000", "", "no line m_depthShift"),
        ("m_depthShift = 4000", "m_depthShift = 0", "units of depth a metre, positive"),
        ("m_colorWidth = 96", "m_colorWidth = wide", "invalid literal"),
        ("m_colorWidth = 96\nm_colorHeight = 72", "m_colorWidth = 0\nm_colorHeight = 0",
         "no colour camera"),
        ("m_calibrationColorIntrinsic = ", "m_calibrationColorIntrinsic = 1 ", "17 values"),
        ("m_calibrationColorExtrinsic = 1", "m_calibrationColorExtrinsic = 2", "not a rigid"),
        ("m_calibrationDepthIntrinsic = ", "m_calibrationDepthIntrinsic = -", "not a camera"),
    ],
)  # fmt: skip
def test_damage(folder: Path, line: str, instead: str, message: str) -> None:
    info = (folder / "_info.txt").read_text()
    assert line in info
    (folder / "_info.txt").write_text(info.replace(line, instead))
    with pytest.raises(TFLabError, match=rf"_info\.txt.*{message}"):
        open_capture(folder)
