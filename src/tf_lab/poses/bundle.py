"""Bundle adjustment (Triggs et al. 2000) that holds on to given poses.

Points and cameras are moved together until the points are where the images show them. That alone
leaves the world's place and size open, and lets a long sequence bend; so every camera is drawn
back to its given pose, in a measure of how wrong that may be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded
from scipy.sparse import bsr_matrix
from scipy.spatial.transform import Rotation

from tf_lab.poses.tracks import Tracks

STEPS = 30  # at most
SETTLED = 1e-4  # a step that lowers the cost by a smaller share is the last
LEAST_DEPTH = 0.05  # metres
TAIL = 3.0  # deviations; larger errors count ever less (Cauchy): a point was mistaken
START_DEPTH = 2.0  # metres, of points that given poses put behind a camera or nowhere


@dataclass(frozen=True)
class Deviations:
    """How wrong things are, as standard deviations.

    Attributes:
        rotation: of the given poses, degrees, about each axis.
        translation: of the given poses, metres, along each axis.
        pixel: of where points are seen, pixels. More than a single one is wrong by: the errors of
            neighbours, and of a point from one image to the next, are alike.
    """

    rotation: float = 0.3
    translation: float = 0.005
    pixel: float = 1.0


class _Problem:
    """The cost of poses and points, and the steps that lower it."""

    def __init__(
        self, tracks: Tracks, K: np.ndarray, world_T_cam: np.ndarray, deviations: Deviations
    ) -> None:
        self.frame, self.point, self.deviation = tracks.frame, tracks.point, deviations.pixel
        focal, center = K[:, [0, 1], [0, 1]][self.frame], K[:, :2, 2][self.frame]
        self.focal, self.ray = focal, (tracks.pixel - center) / focal
        self.R0, self.t0 = world_T_cam[:, :3, :3], world_T_cam[:, :3, 3]
        self.cameras, self.points = len(K), int(self.point.max()) + 1
        spread = [np.radians(deviations.rotation)] * 3 + [deviations.translation] * 3
        self.prior = 1 / np.square(spread)
        self.first = np.unique(self.point, return_index=True)[1]  # a point's first sighting
        self.anchor = self.frame[self.first]

    def start(self) -> np.ndarray:
        """Points [M, 3] as x/z, y/z, 1/z in the given camera of their first sighting."""
        ray = np.concatenate([self.ray, np.ones((len(self.ray), 1))], 1)
        way = np.einsum("nij,nj->ni", self.R0[self.frame], ray)
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        across = np.eye(3) - way[:, :, None] * way[:, None]
        left, right = np.zeros((self.points, 3, 3)), np.zeros((self.points, 3))
        np.add.at(left, self.point, across)
        np.add.at(right, self.point, np.einsum("nij,nj->ni", across, self.t0[self.frame]))
        world = np.linalg.solve(left + 1e-6 * np.eye(3), right[..., None])[..., 0]
        local = np.einsum("nji,nj->ni", self.R0[self.anchor], world - self.t0[self.anchor])
        poor = (local[:, 2] < 0.3) | (local[:, 2] > 10)
        local[poor] = START_DEPTH * ray[self.first[poor]]
        return np.concatenate([local[:, :2], np.ones((len(local), 1))], 1) / local[:, 2:]

    def world(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points in the world [M, 3], and how they move there with their numbers, [M, 3, 3]."""
        depth = 1 / np.maximum(points[:, 2], 0.02)
        local = np.concatenate([points[:, :2], np.ones((len(points), 1))], 1) * depth[:, None]
        change = np.zeros((len(points), 3, 3))
        change[:, 0, 0] = change[:, 1, 1] = depth
        change[:, :, 2] = -local * depth[:, None]
        R = self.R0[self.anchor]
        return np.einsum("nij,nj->ni", R, local) + self.t0[self.anchor], R @ change

    def offsets(self, R: np.ndarray, t: np.ndarray) -> np.ndarray:
        """How far cameras are from the given ones, [F, 6]: turn (radians) and move (metres)."""
        turn = Rotation.from_matrix(np.einsum("nji,njk->nik", self.R0, R)).as_rotvec()
        return np.concatenate([turn, np.einsum("nji,nj->ni", self.R0, t - self.t0)], 1)

    def errors(
        self, R: np.ndarray, t: np.ndarray, world: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sightings' errors [N, 2] in deviations, and the points in their cameras [N, 3]."""
        away = world[self.point] - t[self.frame]
        local = np.einsum("nji,nj->ni", R[self.frame], away)
        local[:, 2] = np.maximum(local[:, 2], LEAST_DEPTH)
        error = (local[:, :2] / local[:, 2:] - self.ray) * self.focal / self.deviation
        return error, local

    def cost(self, R: np.ndarray, t: np.ndarray, points: np.ndarray) -> float:
        """What `step` lowers."""
        error, _ = self.errors(R, t, self.world(points)[0])
        tail = TAIL**2 * np.log1p((error**2).sum(1) / TAIL**2)
        return 0.5 * float(tail.sum() + (self.prior * self.offsets(R, t) ** 2).sum())

    def step(
        self, R: np.ndarray, t: np.ndarray, points: np.ndarray, damping: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """A damped Gauss-Newton step of cameras [F, 6] and points [M, 3]; points are eliminated."""
        world, change = self.world(points)
        error, local = self.errors(R, t, world)
        weight = 1 / (1 + (error**2).sum(1) / TAIL**2)
        camera, point = self._jacobians(R, local, change)
        camera_w = camera * weight[:, None, None]
        A = np.zeros((self.cameras, 6, 6))
        np.add.at(A, self.frame, np.einsum("nki,nkj->nij", camera_w, camera))
        A += np.diag(self.prior)
        right = self.prior * self.offsets(R, t)
        np.add.at(right, self.frame, np.einsum("nki,nk->ni", camera_w, error))
        D = np.zeros((self.points, 3, 3))
        np.add.at(D, self.point, np.einsum("nki,nkj->nij", point * weight[:, None, None], point))
        below = np.zeros((self.points, 3))
        np.add.at(below, self.point, np.einsum("nki,nk,n->ni", point, error, weight))
        for blocks in (A, D):
            index = np.arange(blocks.shape[1])
            blocks[:, index, index] *= 1 + damping
            blocks[:, index, index] += 1e-9
        return self._solve(A, np.einsum("nki,nkj->nij", camera_w, point), D, right, below)

    def _jacobians(
        self, R: np.ndarray, local: np.ndarray, change: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of the errors, by cameras [N, 2, 6] and by points [N, 2, 3]."""
        count, (x, y, z) = len(local), local.T
        projection = np.zeros((count, 2, 3))
        projection[:, 0, 0] = projection[:, 1, 1] = 1 / z
        projection[:, 0, 2], projection[:, 1, 2] = -x / z**2, -y / z**2
        projection *= self.focal[:, :, None] / self.deviation
        turned = np.zeros((count, 3, 3))  # of a small turn of the camera: local x turn
        turned[:, 0, 1], turned[:, 0, 2], turned[:, 1, 2] = -z, y, -x
        turned -= turned.transpose(0, 2, 1)
        camera = np.concatenate([projection @ turned, -projection], 2)
        return camera, projection @ R[self.frame].transpose(0, 2, 1) @ change[self.point]

    def _solve(
        self,
        A: np.ndarray,
        B: np.ndarray,
        D: np.ndarray,
        right: np.ndarray,
        below: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve [A B; B' D] = -(right, below), of blocks, by the Schur complement of D.

        Which is zero but in a band: points are followed from image to image, so that two cameras
        that are further apart in time than the longest track share none.
        """
        order = np.argsort(self.frame, kind="stable")
        starts = np.searchsorted(self.frame[order], np.arange(self.cameras + 1))
        shape = (6 * self.cameras, 3 * self.points)
        coupling = bsr_matrix((B[order], self.point[order], starts), shape=shape)
        inverse = np.linalg.inv(D)
        blocks = bsr_matrix((inverse, np.arange(self.points), np.arange(self.points + 1)))
        own = bsr_matrix((A, np.arange(self.cameras), np.arange(self.cameras + 1)))
        reduced = (own - coupling @ blocks @ coupling.T).tocoo()
        below_diagonal = reduced.row - reduced.col
        lower = below_diagonal >= 0
        bands = np.zeros((below_diagonal.max() + 1, 6 * self.cameras))
        bands[below_diagonal[lower], reduced.col[lower]] = reduced.data[lower]
        there = np.einsum("mij,mj->mi", inverse, below).ravel()
        cameras = solveh_banded(bands, coupling @ there - right.ravel(), lower=True)
        points = -there.reshape(-1, 3) - np.einsum(
            "mij,mj->mi", inverse, (coupling.T @ cameras).reshape(-1, 3)
        )
        return cameras.reshape(-1, 6), points


def adjust(
    tracks: Tracks, K: np.ndarray, world_T_cam: np.ndarray, deviations: Deviations
) -> tuple[np.ndarray, tuple[float, float]]:
    """Poses under which the tracks are seen where they are, near to the given ones.

    Args:
        tracks: of frames of these numbers.
        K: [F, 3, 3].
        world_T_cam: [F, 4, 4].
        deviations: how far to trust what.

    Returns:
        world_T_cam like the given ones; and the median error of a sighting in pixels, before
        (with points placed by the given poses) and after.
    """
    if not len(tracks.frame):
        return world_T_cam.copy(), (0.0, 0.0)
    problem = _Problem(tracks, K, world_T_cam, deviations)
    R, t, points = problem.R0, problem.t0, problem.start()
    before = _median(problem, R, t, points)
    cost, damping = problem.cost(R, t, points), 1e-3
    for _ in range(STEPS):
        camera, change = problem.step(R, t, points, damping)
        turned = R @ Rotation.from_rotvec(camera[:, :3]).as_matrix()
        moved = t + np.einsum("nij,nj->ni", R, camera[:, 3:])
        tried = problem.cost(turned, moved, points + change)
        if tried < cost:
            settled = cost - tried < SETTLED * cost
            R, t, points, cost, damping = turned, moved, points + change, tried, damping / 5
            if settled:
                break
        else:
            damping *= 10
            if damping > 1e6:
                break
    poses = world_T_cam.copy()
    poses[:, :3, :3], poses[:, :3, 3] = R, t
    return poses, (before, _median(problem, R, t, points))


def _median(problem: _Problem, R: np.ndarray, t: np.ndarray, points: np.ndarray) -> float:
    error, _ = problem.errors(R, t, problem.world(points)[0])
    return float(np.median(np.linalg.norm(error, axis=1))) * problem.deviation
