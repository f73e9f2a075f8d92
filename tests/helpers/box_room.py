"""An analytic scene: a rectangular room with one box on its floor, seen without any renderer."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tf_lab.data.scene import Frame

# Off the lattices of all voxel sizes in use, so that nothing lines up by luck.
ROOM = np.array([[-1.47, -1.23, 0.02], [1.53, 1.27, 2.02]])  # lower, upper: 3 x 2.5 x 2 m
BOX = np.array([[0.33, -0.31, 0.02], [0.93, 0.29, 0.62]])  # 60 cm, on the floor
SIZE = (80, 60)
FOCAL = 45.0


def intrinsics(size: tuple[int, int] = SIZE, focal: float = FOCAL) -> np.ndarray:
    """K [3, 3] with the principal point in the middle of the image."""
    return np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1.0]])


def look(eye: np.ndarray, yaw: float, pitch: float) -> np.ndarray:
    """world_T_cam [4, 4] of a camera that looks along (yaw, pitch), its image's top up."""
    forward = np.array(
        [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], np.float64
    )
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = eye
    return pose


def poses() -> list[np.ndarray]:
    """20 cameras in the room that between them see all its surface, also behind the box."""
    found = [look(np.array([1.2, y, 1.5]), yaw, -0.95) for y, yaw in ((1.0, -1.5), (-1.0, 1.6))]
    for i in range(6):
        yaw = 2 * np.pi * i / 6
        for pitch, height in ((-0.75, 1.45), (0.0, 1.1), (0.75, 0.6)):
            eye = np.array([0.03 - 0.9 * np.cos(yaw), 0.02 - 0.8 * np.sin(yaw), height])
            found.append(look(eye, yaw + 0.15 * pitch, pitch))
    return found


def depth_image(
    pose: np.ndarray, K: np.ndarray | None = None, size: tuple[int, int] = SIZE
) -> np.ndarray:
    """Camera z [h, w] in metres of the first hit of the rays through the pixel centres."""
    K = intrinsics(size) if K is None else K
    u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    camera = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], -1)
    rays = camera @ pose[:3, :3].T + 1e-12
    eye = pose[:3, 3]
    wall = np.maximum((ROOM[0] - eye) / rays, (ROOM[1] - eye) / rays).min(-1)
    slabs = np.stack([(BOX[0] - eye) / rays, (BOX[1] - eye) / rays])
    enter, leave = slabs.min(0).max(-1), slabs.max(0).min(-1)
    hit = (enter < leave) & (enter > 0)
    return np.where(hit, np.minimum(enter, wall), wall)  # camera z = ray parameter, rays have z = 1


def seen_points(pose: np.ndarray, depth: np.ndarray, K: np.ndarray | None = None) -> np.ndarray:
    """The world points [h, w, 3] that the pixels of a depth image show."""
    K = intrinsics((depth.shape[1], depth.shape[0])) if K is None else K
    v, u = np.indices(depth.shape)
    camera = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], -1)
    return np.asarray((camera * depth[..., None]) @ pose[:3, :3].T + pose[:3, 3])


def color_image(pose: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """uint8 [h, w, 3]: a random colour for each 8 cm cell of the world that a pixel shows."""
    cells = np.floor((seen_points(pose, depth) + 7) / 0.08).astype(np.int64) % 64
    table = np.random.default_rng(5).integers(0, 256, (64, 64, 64, 3), np.uint8)
    return table[cells[..., 0], cells[..., 1], cells[..., 2]]


def place_image(pose: np.ndarray, K: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """uint8 [h, w, 3]: each pixel's colour says which point of the room it shows (`places`)."""
    points = seen_points(pose, depth_image(pose, K, size), K)
    return np.round((points - ROOM[0]) / (ROOM[1] - ROOM[0]) * 255).astype(np.uint8)


def places(image: np.ndarray) -> np.ndarray:
    """The world points [h, w, 3] in metres, to 6 mm, that a `place_image` shows."""
    return np.asarray(ROOM[0] + image / 255 * (ROOM[1] - ROOM[0]))


def frames() -> Iterator[Frame]:
    """The whole capture."""
    for i, pose in enumerate(poses()):
        depth = depth_image(pose)
        yield Frame(
            f"{i:04d}", color_image(pose, depth), intrinsics(), pose, depth.astype(np.float32)
        )


def _to_room(points: np.ndarray) -> np.ndarray:
    """Distance [P] to the walls: positive inside the room, negative behind them."""
    beyond = np.maximum(np.maximum(ROOM[0] - points, points - ROOM[1]), 0)
    inside = np.minimum(points - ROOM[0], ROOM[1] - points).min(-1)
    return np.where(inside >= 0, inside, -np.linalg.norm(beyond, axis=-1))


def _to_box(points: np.ndarray) -> np.ndarray:
    """Distance [P] to the box: positive outside, negative inside (its hidden bottom apart)."""
    beyond = np.maximum(np.maximum(BOX[0] - points, points - BOX[1]), 0)
    faces = np.concatenate([points - BOX[0], BOX[1] - points], -1)[..., [0, 1, 3, 4, 5]]
    inside = (beyond == 0).all(-1)
    return np.where(inside, -faces.min(-1), np.linalg.norm(beyond, axis=-1))


def signed_distance(points: np.ndarray) -> np.ndarray:
    """Distance [P] of points [P, 3] to the visible surface, positive in free space."""
    return np.minimum(_to_room(points), _to_box(points))
