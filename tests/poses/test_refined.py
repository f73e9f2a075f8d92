"""Captures with poses that are a little wrong, right, or cannot be judged."""

import numpy as np
import pytest

from helpers.corner import Corner
from helpers.pose_errors import between
from tf_lab.data.camera_noise import Disturbed
from tf_lab.data.keyframes import select_keyframes
from tf_lab.data.settings import CameraNoise
from tf_lab.poses.refined import Refined


@pytest.mark.parametrize("broken", [(), (7,)])
def test_wrong_poses_become_right(broken: tuple[int, ...]) -> None:
    """Those of a capture with a frame that cannot be read, too."""
    corner = Corner(broken=broken)
    given = Disturbed(corner, CameraNoise(translation=0.005, rotation=0.3))
    done: list[tuple[int, int]] = []
    refined = Refined(given, 0.01, progress=lambda *state: done.append(state))
    assert not refined.change.kept and refined.change.after < 0.3 < refined.change.before
    keep = [i for i in range(24) if i not in broken]
    was, now = (between(corner.world_T_cam[keep], c.world_T_cam[keep]) for c in (given, refined))
    assert now[0] < 0.35 * was[0] and now[1] < 0.7 * was[1]
    assert 0.1 < refined.change.turn < 1 and 0.001 < refined.change.move < 0.02
    assert done[-1] == (24, 24)
    assert (refined.image(0) == corner.image(0)).all() and refined.frames == corner.frames


def test_right_poses_are_left_alone() -> None:
    corner = Corner()
    refined = Refined(corner, 0.01)
    assert refined.change.kept and refined.change.turn == refined.change.move == 0
    assert (refined.world_T_cam == corner.world_T_cam).all()


def test_a_frame_between_moves_as_the_keyframe_before_it() -> None:
    given = Disturbed(Corner(), CameraNoise(translation=0.005, rotation=0.3))
    refined = Refined(given, 0.15)
    keyframes = select_keyframes(given.world_T_cam, 0.15)
    assert not refined.change.kept and 4 < len(keyframes) < 24
    corrections = np.linalg.inv(given.world_T_cam) @ refined.world_T_cam
    for i in range(24):
        before = max(k for k in keyframes if k <= i)
        np.testing.assert_allclose(corrections[i], corrections[before], atol=1e-12)


def test_nothing_to_follow() -> None:
    corner = Corner(6, broken=tuple(range(6)))
    refined = Refined(corner, 0.01)
    assert refined.change.kept and refined.change.sightings == 0
    assert (refined.world_T_cam == corner.world_T_cam).all()
