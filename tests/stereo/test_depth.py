"""Depth of frames that show a scene of known depth, and what it must not depend on."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.textured_wall import frame, wall_depth
from tf_lab.stereo.depth import SETTINGS, DepthSequence, depth_of, small_view


def sequence(tilt: float = 0.0, width: int = 80, count: int = 4) -> list[np.ndarray]:
    """Depth maps of a walk of 12 cm steps past a wall 2 m away."""
    depths = DepthSequence()
    return [depths.add(*frame(0.12 * i, tilt, width)) for i in range(count)]


@pytest.mark.parametrize(("tilt", "most"), [(0.0, 0.01), (0.5, 0.015)])
def test_depth_of_a_wall(tilt: float, most: float) -> None:
    """Within 3 % where sources see it, the step of a plane being 10 %; and sure of it."""
    depth, score = sequence(tilt)[-1]
    truth = wall_depth(0.36, tilt, 80)
    inner = (
        slice(5, -5),
        slice(5, -20),
    )  # the sources stand to the left, and see less of the right
    error = np.abs(depth - truth)[inner] / truth[inner]
    assert np.median(error) < most and np.mean(error < 0.03) > 0.95
    assert np.median(score[inner]) > 0.8


def test_the_first_frame_has_none() -> None:
    first = sequence(count=1)[0]
    assert first.shape == (2, 60, 80) and first.dtype == np.float32
    assert (first == 0).all()


def test_only_earlier_frames_count() -> None:
    """So that what was said of a frame once stays true."""
    views = [small_view(*frame(0.12 * i, 0.0, 80), 80) for i in range(4)]
    every = sequence()
    for i in range(4):
        np.testing.assert_array_equal(depth_of(views[: i + 1], i), every[i])
        np.testing.assert_array_equal(depth_of(views, i), every[i])


def test_low_precision_elsewhere_does_not_round_it() -> None:
    with torch.autocast("cpu", torch.bfloat16):
        rounded = sequence()[-1]
    np.testing.assert_array_equal(rounded, sequence()[-1])


def test_larger_images_are_made_small() -> None:
    """The same wall at twice the size: maps of the same size, of nearly the same depth."""
    large, small = sequence(width=160)[-1][0], sequence(width=80)[-1][0]
    assert large.shape == small.shape
    assert np.mean(np.abs(large - small)[5:-5, 5:-20] < 0.06) > 0.95


def test_the_scale_of_the_world_is_that_of_the_poses() -> None:
    """A camera that moves half as far, past a wall half as far away, sees the same images."""
    settings = replace(SETTINGS, baseline=(0.0, 2.0, 0.25), near=0.2, far=4.0)
    half = replace(settings, near=0.1, far=2.0)
    views = [small_view(*frame(0.12 * i, 0.0, 80), 80) for i in range(2)]
    near = []
    for view in views:
        pose = view.world_T_cam.copy()
        pose[:3, 3] /= 2
        near.append(view._replace(world_T_cam=pose))
    whole, halved = depth_of(views, 1, settings), depth_of(near, 1, half)
    np.testing.assert_allclose(halved[0], whole[0] / 2, rtol=1e-4)
    np.testing.assert_allclose(halved[1], whole[1], atol=1e-4)


def test_a_wrong_pose_costs_depth() -> None:
    """Half a degree of turn is half a pixel: the depth is off by more than it is with the pose."""
    depths, wrong = DepthSequence(), DepthSequence()
    for i in range(3):
        image, K, pose = frame(0.12 * i, 0.0, 80)
        right = depths.add(image, K, pose)
        turn = np.radians(0.5 if i == 2 else 0)
        turned = pose.copy()
        turned[:3, :3] = pose[:3, :3] @ [
            [np.cos(turn), 0, np.sin(turn)],
            [0, 1, 0],
            [-np.sin(turn), 0, np.cos(turn)],
        ]
        off = wrong.add(image, K, turned)
    truth = wall_depth(0.24, 0.0, 80)
    inner = (slice(5, -5), slice(5, -20))
    error = [np.median(np.abs(depth[0] - truth)[inner]) for depth in (right, off)]
    assert error[0] < 0.03 < 0.1 < error[1]
