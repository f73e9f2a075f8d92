"""Which way is up: known directions recovered, and a real capture's given one."""

import logging
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tf_lab.data.gravity import align, estimate_down, find_down
from tf_lab.data.readers import seven_scenes
from tf_lab.errors import TFLabError


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Degrees between two directions."""
    cosine = a @ b / np.linalg.norm(a) / np.linalg.norm(b)
    return math.degrees(math.acos(np.clip(cosine, -1, 1)))


def handheld(
    yaw_spread: float, roll: float = 0.0, pitch: float = 20.0, count: int = 200
) -> np.ndarray:
    """world_T_cam in a z-up world: level x axes but for ``roll``, looking down by ``pitch``."""
    random = np.random.default_rng(0)
    yaw = random.uniform(-yaw_spread, yaw_spread, count)
    tilt = random.normal(pitch, 10, count)
    turn = random.normal(0, roll, count)
    level = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # looks along +y
    body = Rotation.from_euler("ZXY", np.stack([yaw, -tilt, turn], axis=1), degrees=True)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = body.as_matrix() @ level
    poses[:, :3, 3] = random.uniform(-2, 2, (count, 3))
    return poses


def turned(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The poses in an arbitrarily turned world, and gravity there."""
    rotation = Rotation.from_rotvec([0.7, -1.9, 0.4]).as_matrix()
    result = poses.copy()
    result[:, :3] = rotation @ poses[:, :3]
    return result, rotation @ [0, 0, -1.0]


def test_level_cameras_give_the_vertical_exactly() -> None:
    poses, down = turned(handheld(yaw_spread=60))
    assert angle(estimate_down(poses), down) < 1e-4


def test_rolling_hands_give_it_within_a_degree() -> None:
    poses, down = turned(handheld(yaw_spread=60, roll=4))
    assert angle(estimate_down(poses), down) < 1


def test_cameras_that_never_turn_fall_back_to_their_own_down(
    caplog: pytest.LogCaptureFixture,
) -> None:
    poses, down = turned(handheld(yaw_spread=0.5, roll=0.5, pitch=12))
    with caplog.at_level(logging.WARNING):
        estimate = estimate_down(poses)
    assert "hardly turn" in caplog.text
    assert angle(estimate, down) < 14  # the mean pitch, as documented


@pytest.mark.parametrize("down", [[0, 0, -1], [0, 0, 1], [0, 2, 0], [0.1, 0.9, 0.4]])
def test_align_takes_down_to_minus_z_and_tells_the_way_back(down: list[float]) -> None:
    source = handheld(yaw_spread=60)
    upright, source_T_world = align(source, np.array(down, float))
    direction = np.array(down) / np.linalg.norm(down)
    np.testing.assert_allclose(source_T_world @ [0, 0, -1, 0], [*direction, 0], atol=1e-12)
    np.testing.assert_allclose(source_T_world @ upright, source, atol=1e-12)
    np.testing.assert_array_equal(source_T_world[:3, 3], 0)
    np.testing.assert_array_equal(upright[:, 3], source[:, 3])


def test_a_world_that_is_z_up_stays_as_it_is() -> None:
    source = handheld(yaw_spread=60)
    upright, source_T_world = align(source, np.array([0.0, 0.0, -1.0]))
    np.testing.assert_array_equal(source_T_world, np.eye(4))
    np.testing.assert_array_equal(upright, source)


def test_the_file_comes_first_then_the_user_then_the_estimate(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    poses = handheld(yaw_spread=60)
    caplog.set_level(logging.INFO)
    np.testing.assert_allclose(find_down(tmp_path, poses), [0, 0, -1], atol=1e-5)
    assert "estimated" in caplog.text
    np.testing.assert_array_equal(find_down(tmp_path, poses, [0, 5, 0]), [0, 1, 0])
    assert "as given" in caplog.text
    (tmp_path / "gravity-direction.txt").write_text("2\n0\n0\n")
    np.testing.assert_array_equal(find_down(tmp_path, poses, [0, 5, 0]), [1, 0, 0])
    assert "not the given gravity" in caplog.text


@pytest.mark.parametrize("content", ["0 1", "0 0 0", "nan 0 1", "down", ""])
def test_a_bad_direction_file_is_named(tmp_path: Path, content: str) -> None:
    (tmp_path / "gravity-direction.txt").write_text(content)
    with pytest.raises(TFLabError, match=r"gravity-direction\.txt"):
        find_down(tmp_path, handheld(yaw_spread=60))


@pytest.mark.parametrize("given", [[0, 1], [0, 0, 0], [math.inf, 0, 0]])
def test_a_bad_given_direction_is_told(tmp_path: Path, given: list[float]) -> None:
    with pytest.raises(TFLabError, match="direction"):
        find_down(tmp_path, handheld(yaw_spread=60), given)


def test_estimate_on_a_real_capture(redkitchen: Path) -> None:
    poses = seven_scenes.read(redkitchen).world_T_cam
    stated = np.loadtxt(redkitchen / "gravity-direction.txt")
    assert angle(estimate_down(poses), stated) < 10  # measured 6.3
