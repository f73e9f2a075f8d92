"""The camera's walk: a smooth, hand-held path through the free space, looking all around."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from embreex.rtcore_scene import EmbreeScene
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from tf_lab.data.rooms.footprint import CELL, FreeSpace
from tf_lab.data.rooms.layout import Rect
from tf_lab.geometry import pose_distance

Rng = np.random.Generator
STEP = 0.12  # the keyframes' pose distance between frames
CLEAR = 0.4  # metres between the camera and what stands or hangs beside it
STRIDE = 0.06  # metres of path between decisions where to look
APART = 8.0  # metres that another room is farther away than it is
STOPS = 0.35  # the share of ways that lead to something to look at from near
NEAR = 0.5  # metres from where one stands to look at something from near: there one does
CONE = np.cos(np.radians(23))  # what counts as seen: about the image's inscribed cone


def rotation(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """Camera-to-world rotations [N, 3, 3]; yaw from +x, pitch up, roll clockwise (radians)."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    forward = np.stack([cy * cp, sy * cp, sp], axis=-1)
    right = np.stack([sy, -cy, np.zeros_like(cy)], axis=-1)
    down = np.cross(forward, right)
    cr, sr = np.cos(roll)[:, None], np.sin(roll)[:, None]
    return np.stack([cr * right + sr * down, cr * down - sr * right, forward], axis=-1)


@dataclass(frozen=True)
class Habits:
    """How a camera is carried.

    Attributes:
        height: usual, lowest and highest (m).
        reach: [R, 2] places (m) that the walk must be able to get to.
        rooms: floors, each of which wants to be walked through.
        tables: [T, 3] places (m) to look at from near.
        stands: [T, 2] where to stand for that.
    """

    height: tuple[float, float, float] = (1.5, 1.3, 1.7)
    reach: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    rooms: tuple[Rect, ...] = ()
    tables: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    stands: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))


def make_walk(
    space: FreeSpace,
    scene: EmbreeScene,
    targets: np.ndarray,
    frames: int,
    rng: Rng,
    habits: Habits | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """A walk, of which frames are filmed whose steps measure about `STEP`.

    Args:
        space: where there is room to walk.
        scene: the triangles, to know what hides what.
        targets: [P, 3] surface points that want to be seen.
        frames: how many are filmed; more frames make a longer walk.
        rng: the random source.
        habits: how the camera is carried.

    Returns:
        Poses world_T_cam [N, 4, 4], a centimetre of path apart, and the filmed ones' numbers
        [frames].
    """
    habits = habits or Habits()
    xy = _path(space, (STEP + 0.01) * frames + 0.5, rng, habits)
    n = len(xy)
    usual, lowest, highest = habits.height
    z = np.clip(usual + 0.09 * wave(rng, n, 120), lowest, highest)
    look = _looks(xy, habits)
    z = _stoop(z, look, lowest)
    position = np.column_stack([xy, z])
    every = max(1, round(STRIDE / 0.01))
    yaw, pitch = _gaze(position[::every], scene, targets, rng, look[::every])
    knots = np.arange(len(yaw)) * every
    yaw = gaussian_filter1d(np.interp(np.arange(n), knots, yaw), 9, mode="nearest")
    pitch = gaussian_filter1d(np.interp(np.arange(n), knots, pitch), 9, mode="nearest")
    poses = np.tile(np.eye(4), (n, 1, 1))
    shake = 0.008 * np.stack([wave(rng, n, 9) for _ in range(3)])
    poses[:, :3, :3] = rotation(
        yaw + shake[0], pitch + shake[1], 0.03 * wave(rng, n, 60) + shake[2]
    )
    poses[:, :3, 3] = position
    return poses, _resample(poses, frames, rng)


def _path(space: FreeSpace, length: float, rng: Rng, habits: Habits) -> np.ndarray:
    """A smooth path [N, 2], a point every centimetre, at least `CLEAR` from everything."""
    margin = CLEAR + 0.05
    mask = space.walkable(margin)
    while mask.sum() < 150 or not space.holds(mask, habits.reach):
        margin -= 0.05
        if margin < 0.15:
            raise ValueError("there is no room to walk")
        mask = space.walkable(margin)
    tour = _tour(space, mask, length, rng, habits)
    path = gaussian_filter1d(tour, 4.0, axis=0, mode="nearest")
    for _ in range(12):  # smoothing cut corners: move away from them and smooth a little
        close = space.at(path) < margin
        path[close] += 0.02 * space.uphill(path[close])
        path = gaussian_filter1d(path, 1.0, axis=0, mode="nearest")
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    dense = np.arange(0, along[-1], 0.01)
    return np.stack([np.interp(dense, along, path[:, k]) for k in range(2)], axis=1)


def _tour(
    space: FreeSpace, mask: np.ndarray, length: float, rng: Rng, habits: Habits
) -> np.ndarray:
    """Grid cells' centres [N, 2] of a walk that keeps going where it has not been for long.

    It goes to each room first, then now and then where it can look at something from near.
    """
    centres, stands = space.centres(mask), habits.stands
    room = np.zeros(len(centres))
    for number, rect in enumerate(habits.rooms, start=1):
        room[((centres >= rect[:2]) & (centres <= rect[2:])).all(axis=1)] = number
    waiting = room > 0
    cells = np.argwhere(mask)
    graph = _graph(mask, cells, 1 / np.minimum(space.clearance[mask], 0.5))
    here, walked = int(rng.integers(len(cells))), 0.0
    path, unseen = [here], np.full(len(cells), 9.0)
    while walked < 1.3 * length:  # smoothing shortens it
        ahead = np.linalg.norm(cells - cells[here], axis=1) * CELL
        score = unseen + 0.3 * np.minimum(ahead, 3) + rng.uniform(0, 0.6, len(cells))
        goal = int(np.argmax(score + 10 * waiting))
        if len(stands) and not waiting.any() and rng.random() < STOPS:
            stand = stands[rng.integers(len(stands))]
            goal = int(np.argmin(((centres - stand) ** 2).sum(axis=1)))
        before = dijkstra(graph, directed=False, indices=goal, return_predecessors=True)[1]
        while here != goal:
            after = int(before[here])
            walked += float(np.linalg.norm(cells[after] - cells[here])) * CELL
            here = after
            path.append(here)
            waiting &= room != room[here]
            gap = np.linalg.norm(cells - cells[here], axis=1) * CELL + APART * (room != room[here])
            unseen = np.minimum(unseen + 0.004, gap)
    return space.low + (cells[path] + 0.5) * CELL


def _graph(mask: np.ndarray, cells: np.ndarray, cost: np.ndarray) -> csr_matrix:
    """Eight-connected cells; ``cost`` [N] a metre."""
    number = -np.ones(mask.shape, int)
    number[mask] = np.arange(len(cells))
    starts, ends, weights = [], [], []
    for step in ((1, 0), (0, 1), (1, 1), (1, -1)):
        there = np.clip(cells + step, 0, np.array(mask.shape) - 1)
        a = np.flatnonzero(mask[there[:, 0], there[:, 1]] & (there == cells + step).all(axis=1))
        b = number[there[a, 0], there[a, 1]]
        starts.append(a)
        ends.append(b)
        weights.append(np.hypot(*step) * (cost[a] + cost[b]))
    where = np.concatenate(starts), np.concatenate(ends)
    return csr_matrix((np.concatenate(weights), where), shape=(len(cells), len(cells)))


def _looks(xy: np.ndarray, habits: Habits) -> np.ndarray:
    """What is looked at from near [N, 3] (NaN: nothing) along a path [N, 2]."""
    look = np.full((len(xy), 3), np.nan)
    for table, stand in zip(habits.tables, habits.stands, strict=True):
        look[np.linalg.norm(xy - stand, axis=1) < NEAR] = table
    return look


def _stoop(z: np.ndarray, look: np.ndarray, lowest: float) -> np.ndarray:
    """Heights [N] (m), lower where something is looked at from near."""
    near = ~np.isnan(look[:, 2])
    if not near.any():
        return z
    low = np.where(near, np.clip(look[:, 2] + 0.5, lowest, z), z)
    return gaussian_filter1d(low, 25, mode="nearest")


def _gaze(
    position: np.ndarray,
    scene: EmbreeScene,
    targets: np.ndarray,
    rng: Rng,
    look: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Yaw and pitch [S] at positions [S, 3]: turn smoothly to where most is still unseen.

    Or to what is looked at from near, ``look`` [S, 3] where it is not NaN.
    """
    offset = targets[None] - position[:, None]
    distance = np.linalg.norm(offset, axis=-1)
    rays = (offset / distance[..., None]).astype(np.float32)
    visible = _visible(scene, position, rays, distance) & (distance < 5)
    seen = rng.uniform(0, 2, len(targets))
    first = rays[0, np.argmax(np.where(visible[0], distance[0], 0))]
    angles = np.array([np.arctan2(first[1], first[0]), -0.3])
    rate, goal, age = np.zeros(2), angles.copy(), 0
    level = np.clip(-0.3 + 0.12 * wave(rng, len(position), 12), -0.6, 0.15)  # a habit of pitch
    out = np.empty((len(position), 2))
    for i, ray in enumerate(rays):
        age += 1
        if age > 14 or np.abs(goal - angles).max() < 0.12:
            goal, age = _look(ray, visible[i], distance[i], seen, angles, level[i], rng), 0
        if not np.isnan(look[i, 0]):
            goal, age = _towards(look[i] - position[i], angles), 0
        rate += 0.35 * (np.clip(0.4 * (goal - angles), -0.13, 0.13) - rate)
        angles = angles + rate
        out[i] = angles
        forward = rotation(*(np.array([a]) for a in (*angles, 0.0)))[0, :, 2]
        seen += visible[i] & (ray @ forward > CONE)
    return out[:, 0], out[:, 1]


def _towards(offset: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Yaw and pitch of a direction [3], the yaw within half a turn of that of ``angles``."""
    turn = (np.arctan2(offset[1], offset[0]) - angles[0] + np.pi) % (2 * np.pi) - np.pi
    return np.array([angles[0] + turn, np.arctan2(offset[2], np.hypot(*offset[:2]))])


def _look(
    ray: np.ndarray,
    visible: np.ndarray,
    distance: np.ndarray,
    seen: np.ndarray,
    angles: np.ndarray,
    level: float,
    rng: Rng,
) -> np.ndarray:
    """Yaw and pitch, near ``level``, whose cone holds the most points that were seldom seen."""
    need = visible / (1 + seen / 15)
    inside = ray @ ray.T > CONE
    value = inside @ need.astype(np.float32)
    turn = (np.arctan2(ray[:, 1], ray[:, 0]) - angles[0] + np.pi) % (2 * np.pi) - np.pi
    pitch = np.arcsin(ray[:, 2])
    habit = np.exp(-(((pitch - level) / 0.35) ** 2))
    value = value * habit * (1 - 0.1 * np.abs(turn)) * rng.uniform(0.8, 1, len(seen))
    best = int(np.argmax(np.where(visible & (distance > 0.9), value, -1)))
    return np.array([angles[0] + turn[best], np.clip(pitch[best], -0.65, 0.25)])


def _visible(
    scene: EmbreeScene, position: np.ndarray, rays: np.ndarray, distance: np.ndarray
) -> np.ndarray:
    """Whether nothing lies between positions [S, 3] and targets [P, 3]: bool [S, P]."""
    start = np.broadcast_to(position[:, None], rays.shape).reshape(-1, 3).astype(np.float32)
    reach = (distance - 0.02).reshape(-1).astype(np.float32)
    hit = scene.run(start, rays.reshape(-1, 3), dists=reach, query="OCCLUDED")
    return (hit != 0).reshape(distance.shape)


def wave(rng: Rng, n: int, sigma: float) -> np.ndarray:
    """Smooth noise [n] of unit variance and correlation length ``sigma``."""
    pad = int(4 * sigma)
    field = gaussian_filter1d(rng.standard_normal(n + 2 * pad), sigma)[pad : n + pad]
    return field * np.sqrt(2 * np.sqrt(np.pi) * sigma)


def _resample(poses: np.ndarray, frames: int, rng: Rng) -> np.ndarray:
    """Numbers of poses each about `STEP` (pose distance) from the one before."""
    steps = STEP * (1 + 0.05 * np.clip(wave(rng, frames, 3), -2, 2))
    chosen = [0]
    for step in steps[1:]:
        last = chosen[-1]
        ahead = poses[last + 1 : last + 200]
        far = pose_distance(poses[last], ahead)[0] >= step
        if not far.any():
            raise ValueError("the path is too short for the walk")
        chosen.append(last + 1 + int(np.argmax(far)))
    return np.array(chosen)
