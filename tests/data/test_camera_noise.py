"""Cameras made wrong: by as much as is asked for, and only in copies."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tf_lab.data.camera_noise import Disturbed, disturb_cameras, share_of
from tf_lab.data.scene import Scene
from tf_lab.data.settings import CameraNoise

NOISE = CameraNoise(translation=0.01, rotation=0.5, focal=0.02)
VIEWS = 400


def cameras() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    K = np.tile(np.array([[120.0, 0, 79.5], [0, 121, 59.5], [0, 0, 1]]), (VIEWS, 1, 1))
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, :3, :3] = Rotation.random(VIEWS, rng=rng).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(VIEWS, 3))
    return K, poses


def errors(noise: CameraNoise, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shifts [V, 3] (m), turns [V, 3] (degrees), ratios of focal lengths [V, 2]."""
    K, poses = cameras()
    K2, poses2 = disturb_cameras(K, poses, noise, np.random.default_rng(seed))
    again = cameras()
    assert (again[0] == K).all() and (poses == again[1]).all(), "the given ones stay"
    np.testing.assert_array_equal(K2[:, :2, 2], K[:, :2, 2])
    turned = poses[:, :3, :3].swapaxes(1, 2) @ poses2[:, :3, :3]
    turns = np.degrees(Rotation.from_matrix(turned).as_rotvec())
    return (poses2 - poses)[:, :3, 3], turns, K2[:, [0, 1], [0, 1]] / K[:, [0, 1], [0, 1]]


def test_deviations_are_what_is_asked_for() -> None:
    shifts, turns, _ = errors(NOISE)
    np.testing.assert_allclose(shifts.std(axis=0), 0.01, rtol=0.15)
    np.testing.assert_allclose(turns.std(axis=0), 0.5, rtol=0.15)
    assert (np.abs(shifts.mean(axis=0)) < 0.002).all() and (np.abs(turns.mean(axis=0)) < 0.1).all()
    assert abs(np.corrcoef(shifts[1:, 0], shifts[:-1, 0])[0, 1]) < 0.2, "each pose by itself"


def test_one_focal_length_errs_as_a_whole() -> None:
    ratios = [errors(NOISE, seed)[2] for seed in range(200)]
    assert all(np.allclose(r, r[0, 0], rtol=1e-12) for r in ratios)
    np.testing.assert_allclose(np.std([np.log(r[0, 0]) for r in ratios]), 0.02, rtol=0.15)


def test_no_noise_and_a_share_of_it() -> None:
    shifts, turns, ratios = errors(CameraNoise())
    assert (shifts == 0).all() and np.abs(turns).max() < 1e-6 and (ratios == 1).all()
    half = errors(share_of(NOISE, 0.5))
    whole = errors(NOISE)
    np.testing.assert_allclose(half[0], whole[0] / 2, atol=1e-12)
    np.testing.assert_allclose(half[1], whole[1] / 2, atol=1e-6)


def test_a_disturbed_capture(box_scene: Path) -> None:
    """Other cameras, the same images, the same errors whenever it is opened."""
    scene = Scene(box_scene)
    wrong, again = (Disturbed(Scene(box_scene), NOISE) for _ in range(2))
    assert (wrong.world_T_cam == again.world_T_cam).all() and (wrong.K == again.K).all()
    off = np.linalg.norm((wrong.world_T_cam - scene.world_T_cam)[:, :3, 3], axis=1)
    assert (off > 0).all() and off.max() < 0.06
    assert wrong.frames == scene.frames and (wrong.image(1) == scene.image(1)).all()
