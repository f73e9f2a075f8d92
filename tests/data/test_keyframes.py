"""The keyframe measure against hand-computed values."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from helpers.injections import source_of
from helpers.layouts import room_frames
from tf_lab.data.keyframes import Thinned, select_keyframes
from tf_lab.geometry import pose_distance


def pose(
    turn: tuple[float, float, float] = (0, 0, 0), at: tuple[float, ...] = (0, 0, 0)
) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    matrix[:3, 3] = at
    return matrix


@pytest.mark.parametrize("angle", [0.0, 0.01, 0.3, math.pi / 2, math.pi])
def test_pure_rotation(angle: float) -> None:
    start = pose((0.3, -0.2, 0.9), (1, 2, 3))
    combined, rotation, translation = pose_distance(start, start @ pose((0, angle, 0)))
    expected = math.sqrt(2 * (1 - (1 + 2 * math.cos(angle)) / 3))
    assert rotation == pytest.approx(expected, abs=1e-7)
    assert translation == 0
    assert combined == pytest.approx(expected, abs=1e-7)


def test_pure_translation() -> None:
    turned = (0.3, -0.2, 0.9)
    combined, rotation, translation = pose_distance(pose(turned), pose(turned, (0.3, 0.0, -0.4)))
    assert rotation == pytest.approx(0, abs=1e-7)
    assert translation == pytest.approx(0.5)
    assert combined == pytest.approx(0.5)


def test_half_a_turn_and_a_metre() -> None:
    # tr = -1: R = sqrt(2 (1 + 1/3)) = sqrt(8/3); with t = 1: sqrt(11/3)
    combined, _, _ = pose_distance(pose(), pose((math.pi, 0, 0), (0, 0, 1)))
    assert combined == pytest.approx(math.sqrt(11 / 3))


def test_a_trace_above_three_counts_as_no_rotation() -> None:
    rounded = pose()
    rounded[:3, :3] *= 1 + 1e-6
    assert pose_distance(rounded, rounded)[0] == 0


unit = st.floats(-1, 1)
triples = st.tuples(unit, unit, unit)


@given(triples, triples, triples, triples)
def test_agrees_with_the_relative_pose(
    turn_a: tuple[float, float, float],
    at_a: tuple[float, float, float],
    turn_b: tuple[float, float, float],
    at_b: tuple[float, float, float],
) -> None:
    a, b = pose(turn_a, at_a), pose(turn_b, at_b)
    relative = np.linalg.inv(a) @ b
    _, rotation, translation = pose_distance(a, b)
    trace = min(3.0, np.trace(relative[:3, :3]))
    assert rotation**2 == pytest.approx(2 * (1 - trace / 3), abs=1e-9)
    assert translation == pytest.approx(np.linalg.norm(relative[:3, 3]), abs=1e-9)


def test_drift_is_measured_from_the_last_keyframe() -> None:
    xs = [0.0, 0.04, 0.08, 0.125, 0.2, 0.25, 0.21, 0.13]
    # keyframes: 0; 0.125; then 0.25 (not 0.2, only 0.075 away); 0.13 is 0.12 back
    track = np.stack([pose(at=(x, 0, 0)) for x in xs])
    assert select_keyframes(track) == [0, 3, 5, 7]
    assert select_keyframes(torch.from_numpy(track)) == [0, 3, 5, 7]


def test_threshold_is_inclusive() -> None:
    track = [pose(), pose(at=(0.25, 0, 0))]
    assert select_keyframes(track, threshold=0.25) == [0, 1]
    assert select_keyframes(track, threshold=0.2501) == [0]


def test_short_sequences() -> None:
    assert select_keyframes(np.zeros((0, 4, 4))) == []
    assert select_keyframes(pose()[None]) == [0]


def test_a_thinned_capture_has_the_frames_of_its_numbers() -> None:
    frames = room_frames()
    whole = source_of(frames)
    thin = Thinned(whole, 5, threshold=0)
    assert thin.frames == [frames[i].name for i in (0, 5, 11, 17, 23)]
    for number, i in enumerate((0, 5, 11, 17, 23)):
        np.testing.assert_array_equal(thin.image(number), frames[i].image)
        np.testing.assert_array_equal(thin.world_T_cam[number], whole.world_T_cam[i])
        np.testing.assert_array_equal(thin.depth(number), whole.depth(i))
    keyframes = select_keyframes(whole.world_T_cam, 0.5)
    assert Thinned(whole, 100, threshold=0.5).kept == keyframes
