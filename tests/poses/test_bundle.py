"""Bundle adjustment against cameras and points that are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.box_room import intrinsics, look
from helpers.pose_errors import between
from tf_lab.poses.bundle import TAIL, Deviations, _Problem, adjust
from tf_lab.poses.tracks import Tracks

CAMERAS = 14
K = np.tile(intrinsics((160, 120), 130.0), (CAMERAS, 1, 1))


def true_poses() -> np.ndarray:
    ways = np.linspace(-1, 1, CAMERAS)
    return np.stack([look(np.array([0.1 * w, w, 1.2]), 0.3 * w, -0.2) for w in ways])


def seen(poses: np.ndarray, count: int = 150) -> Tracks:
    """Where the cameras see points 2 to 4 metres away."""
    points = np.random.default_rng(3).uniform((2, -1.5, 0), (4, 1.5, 2), (count, 3))
    local = np.einsum("fji,fpj->fpi", poses[:, :3, :3], points - poses[:, None, :3, 3])
    pixel = local @ K[0].T
    pixel = pixel[..., :2] / pixel[..., 2:]
    frame, point = np.nonzero(((pixel >= 0) & (pixel <= (159, 119))).all(-1))
    point = np.unique(point, return_inverse=True)[1]
    inside = ((pixel >= 0) & (pixel <= (159, 119))).all(-1)
    return Tracks(frame, point, pixel[inside])


def wrong(poses: np.ndarray, degrees: float = 0.3, metres: float = 0.005) -> np.ndarray:
    rng = np.random.default_rng(4)
    off = poses.copy()
    turns = Rotation.from_rotvec(np.radians(degrees) * rng.normal(size=(len(poses), 3)))
    off[:, :3, :3] = poses[:, :3, :3] @ turns.as_matrix()
    off[:, :3, 3] += metres * rng.normal(size=(len(poses), 3))
    return off


@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_wrong_poses_are_mended(outliers: float) -> None:
    """Also with a tenth of the sightings far from where they should be."""
    poses = true_poses()
    tracks, given = seen(poses), wrong(poses)
    rng = np.random.default_rng(6)
    bad = rng.random(len(tracks.frame)) < outliers
    tracks.pixel[bad] += rng.uniform(-20, 20, (bad.sum(), 2))
    found, (before, after) = adjust(tracks, K, given, Deviations(pixel=0.3))
    turn, move = between(poses, found)
    was_turn, was_move = between(poses, given)
    assert turn < 0.15 * was_turn and move < 0.5 * was_move
    assert before > 0.5 and after < 0.1
    off = np.linalg.inv(given) @ found
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.03, "near to where they were given"


def test_right_poses_stay() -> None:
    poses = true_poses()
    found, (before, after) = adjust(seen(poses), K, poses, Deviations())
    np.testing.assert_allclose(found, poses, atol=2e-5)
    assert after <= before < 1e-3


def test_a_step_is_the_least_squares_solution() -> None:
    """Of residuals linearised by differences, points and cameras solved for at once."""
    poses = true_poses()[:4]
    tracks = seen(true_poses(), 30)
    few = tracks.frame < 4
    tracks = Tracks(
        tracks.frame[few], np.unique(tracks.point[few], return_inverse=True)[1], tracks.pixel[few]
    )
    deviations = Deviations(pixel=100.0)  # so that all weights are one
    problem = _Problem(tracks, K[:4], wrong(poses), deviations)
    R, t, points = problem.R0, problem.t0, problem.start()

    def residuals(x: np.ndarray) -> np.ndarray:
        camera, change = x[:24].reshape(4, 6), x[24:].reshape(-1, 3)
        turned = R @ Rotation.from_rotvec(camera[:, :3]).as_matrix()
        moved = t + np.einsum("nij,nj->ni", R, camera[:, 3:])
        error, _ = problem.errors(turned, moved, problem.world(points + change)[0])
        spread = np.r_[[np.radians(0.3)] * 3, [0.005] * 3]
        return np.concatenate([error.ravel(), (camera / spread).ravel()])

    zero = np.zeros(24 + points.size)
    J = np.stack([(residuals(e) - residuals(-e)) / 2e-5 for e in 1e-5 * np.eye(len(zero))], axis=1)
    assert np.abs(residuals(zero)).max() < 0.1 * TAIL
    known = np.linalg.solve(J.T @ J + 1e-9 * np.eye(len(zero)), -J.T @ residuals(zero))
    camera, change = problem.step(R, t, points, damping=0.0)
    np.testing.assert_allclose(camera.ravel(), known[:24], rtol=1e-3, atol=1e-7)
    np.testing.assert_allclose(change.ravel(), known[24:], rtol=1e-2, atol=1e-5)


def test_trusted_poses_move_less() -> None:
    poses = true_poses()
    given, tracks = wrong(poses), seen(poses)
    moves = []
    for metres, degrees in ((1e-5, 1e-3), (0.005, 0.3)):
        found, _ = adjust(tracks, K, given, Deviations(degrees, metres, 1.0))
        moves.append(np.abs(found - given).max())
    assert moves[0] < 1e-4 < moves[1]


def test_without_sightings_poses_stay() -> None:
    none = Tracks(np.empty(0, int), np.empty(0, int), np.empty((0, 2)))
    found, errors = adjust(none, K, true_poses(), Deviations())
    assert (found == true_poses()).all() and errors == (0.0, 0.0)
