"""A real capture: what is read fits together (frames land on each other where they should)."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tf_lab.data.capture import Capture
from tf_lab.data.readers import open_capture, seven_scenes
from tf_lab.data.readers.source import Rig
from tf_lab.geometry import invert_pose, pixel_directions, project, transform


def test_redkitchen_opens(redkitchen: Path) -> None:
    capture = open_capture(redkitchen)
    assert (capture.size, len(capture.frames), capture.skipped) == ((640, 480), 100, [])
    assert capture.frames[:2] == ["frame-000000", "frame-000005"]
    np.testing.assert_array_equal(capture.K[0], [[525, 0, 320], [0, 525, 240], [0, 0, 1]])
    color = capture.source_T_world @ capture.world_T_cam[0]
    depth_T_color = np.linalg.solve(np.loadtxt(redkitchen / "frame-000000.pose.txt"), color)
    beside = np.eye(4)
    beside[0, 3] = 0.025  # colour is to the right of the depth camera, whose the poses are
    np.testing.assert_allclose(depth_T_color, beside, atol=1e-4)
    depth = capture.depth(50)
    assert depth is not None
    seen = depth[depth > 0]
    assert 0.5 < len(seen) / depth.size < 1
    assert 0.3 < seen.min() < np.median(seen) < seen.max() < 8


def reproject(capture: Capture, i: int, j: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth errors (m) and grey values (of i, of j) where pixels of frame i land in frame j."""
    depth_i, depth_j = capture.depth(i), capture.depth(j)
    assert depth_i is not None
    assert depth_j is not None
    K, poses = torch.from_numpy(capture.K), torch.from_numpy(capture.world_T_cam)
    camera = pixel_directions(K[i], capture.size) * torch.from_numpy(depth_i)[..., None]
    use = depth_i > 0
    points = transform(poses[i], camera[torch.from_numpy(use)])
    uv, z = project(points, K[j], invert_pose(poses[j]))
    u, v = uv.round().long().numpy().T
    width, height = capture.size
    lands = (z.numpy() > 0.1) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v, z_in_j = u[lands], v[lands], z.numpy()[lands]
    known = depth_j[v, u] > 0
    grey_i = capture.image(i)[use][lands][known].mean(-1)
    grey_j = capture.image(j)[v, u][known].mean(-1)
    return (z_in_j - depth_j[v, u])[known], grey_i, grey_j


def test_redkitchen_frames_agree_with_each_other(redkitchen: Path) -> None:
    capture = open_capture(redkitchen)
    for i in (0, 25, 50, 75):
        error, grey_i, grey_j = reproject(capture, i, i + 1)
        assert len(error) > 50_000
        assert np.median(np.abs(error)) < 0.01  # 3-6 mm; with inverted poses 13-170 mm
        assert np.corrcoef(grey_i, grey_j)[0, 1] > 0.93


def test_redkitchen_colour_is_the_colour_camera_s(
    redkitchen: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Colours of points agree best between frames by the cameras that took them."""

    def agreement() -> float:
        capture = open_capture(redkitchen)
        pairs = [reproject(capture, i, i + 4)[1:] for i in range(5, 95, 15)]
        return float(np.mean([np.corrcoef(*greys)[0, 1] for greys in pairs]))

    right = agreement()
    monkeypatch.setattr(seven_scenes, "PUBLISHED", Rig(seven_scenes.DEPTH))
    assert right > agreement() + 0.03  # .937 and .883
