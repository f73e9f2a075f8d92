"""Meshes as clay, by ray casting (embree): no GPU, no display.

Soft light from the upper left, ambient occlusion, and walls seen from behind left out, so that one
looks into a room from above. Faces must point into free space, as those of marching
cubes do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

CLAY = (0.66, 0.74, 0.84)
CUT = 0.5  # metres, off the top of a room to look into
FINE = 2  # rays a pixel along each axis
LIGHT = np.array([-0.45, -0.35, 0.85])
AMBIENT_RAYS = 12
AMBIENT_REACH = 0.6  # metres: what is farther away casts no ambient shadow


@dataclass(frozen=True)
class Hits:
    """What a camera sees of a mesh, `FINE`^2 samples a pixel.

    Attributes:
        shape: (height, width) of the samples' grid.
        samples: int [N, 2], row and column of those that meet the mesh.
        points: [N, 3] where they do, metres.
        triangles: int [N, 3], vertices of the face met.
        brightness: [N], of a white surface there.
    """

    shape: tuple[int, int]
    samples: np.ndarray
    points: np.ndarray
    triangles: np.ndarray
    brightness: np.ndarray


def overview_camera(
    bounds: np.ndarray, size: tuple[int, int] = (640, 480)
) -> tuple[np.ndarray, np.ndarray, float]:
    """A bird's-eye view of a room without its ceiling, filled by the room.

    Args:
        bounds: [2, 3] lower and upper corner, metres, z up.
        size: (width, height) of the picture, pixels.

    Returns:
        K [3, 3], world_T_cam [4, 4] and the height (m) of the cut, for `render_mesh`.
    """
    lower, upper = np.asarray(bounds, np.float64)
    ceiling = max(upper[2] - CUT, (lower[2] + upper[2]) / 2)
    top = np.array([upper[0], upper[1], ceiling])
    # The long side lies across the picture; 25 degrees off the axis shows two walls.
    heading = math.radians(25 if upper[0] - lower[0] >= upper[1] - lower[1] else 115)
    pitch = math.radians(52)
    right = np.array([math.cos(heading), math.sin(heading), 0.0])
    ahead = np.array([-right[1], right[0], 0.0])
    forward = math.cos(pitch) * ahead - math.sin(pitch) * np.array([0.0, 0.0, 1.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    corners = np.array(np.meshgrid(*np.stack([lower, top], axis=1))).reshape(3, -1).T
    center = (lower + top) / 2
    local = (corners - center) @ rotation
    distance = 2.2 * float(np.linalg.norm(top - lower))  # far enough for a mild perspective
    plane = local[:, :2] / (local[:, 2:] + distance)
    low, high = plane.min(0), plane.max(0)
    focal = 0.96 * float(np.min(np.array(size) / (high - low)))
    K = np.diag([focal, focal, 1.0])
    K[:2, 2] = (np.array(size) - 1) / 2 - focal * (low + high) / 2
    world_T_cam = np.eye(4)
    world_T_cam[:3, :3] = rotation
    world_T_cam[:3, 3] = center - distance * forward
    return K, world_T_cam, float(ceiling)


def render_mesh(
    mesh: trimesh.Trimesh,
    K: np.ndarray,
    world_T_cam: np.ndarray,
    size: tuple[int, int],
    ceiling: float | None = None,
    vertex_colors: np.ndarray | None = None,
) -> np.ndarray:
    """A shaded picture of a mesh on white.

    Args:
        mesh: metres, faces towards free space; may be empty.
        K: [3, 3] pixels.
        world_T_cam: [4, 4].
        size: (width, height), pixels.
        ceiling: everything above this height (m) is cut off; None cuts nothing.
        vertex_colors: uint8 [V, 3]; clay without them.

    Returns:
        uint8 [height, width, 3].
    """
    hits = cast(mesh, K, world_T_cam, size, ceiling)
    if vertex_colors is None:
        return shade(hits, np.array(CLAY))
    corners = np.asarray(mesh.vertices)[hits.triangles]
    weights = trimesh.triangles.points_to_barycentric(corners, hits.points)
    return shade(hits, np.einsum("nk,nkc->nc", weights, vertex_colors[hits.triangles] / 255))


def cast(
    mesh: trimesh.Trimesh,
    K: np.ndarray,
    world_T_cam: np.ndarray,
    size: tuple[int, int],
    ceiling: float | None = None,
) -> Hits:
    """First hits of the rays through a picture, `FINE`^2 a pixel; arguments as `render_mesh`."""
    width, height = size[0] * FINE, size[1] * FINE
    center = world_T_cam[:3, 3]
    keep = np.einsum("ij,ij->i", mesh.face_normals, center - mesh.triangles_center) > 0
    if ceiling is not None:
        keep &= mesh.triangles[:, :, 2].min(1) < ceiling
    shown = trimesh.Trimesh(mesh.vertices, mesh.faces[keep], process=False)
    row, column = np.divmod(np.arange(width * height), width)
    pixel = (np.stack([column, row], axis=1) + 0.5) / FINE - 0.5
    camera = np.column_stack([pixel, np.ones(len(pixel))]) @ np.linalg.inv(K).T
    directions = trimesh.unitize(camera @ world_T_cam[:3, :3].T)
    origins = np.tile(center, (len(directions), 1))
    if ceiling is not None and center[2] > ceiling:  # rays start on the cut: it is exact
        steepness = np.minimum(directions[:, 2], -1e-6)
        origins += directions * ((ceiling - center[2]) / steepness)[:, None]
    rays = _Rays(shown)
    face = rays.first_hit(origins, directions)
    hit = face >= 0
    face, origins, directions = face[hit], origins[hit], directions[hit]
    normals, anchors = shown.face_normals[face], shown.triangles[face, 0]
    depth = np.einsum("ij,ij->i", anchors - origins, normals)
    depth /= np.einsum("ij,ij->i", directions, normals)
    points = origins + depth[:, None] * directions
    samples = np.stack([row[hit], column[hit]], axis=1)
    brightness = _brightness(rays, points, normals)
    return Hits((height, width), samples, points, shown.faces[face], brightness)


class _Rays:
    """Rays into a mesh. Those of trimesh cannot be told how far to look.

    Embree computes in float32: from the mesh's middle, wherever the world's origin is.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._scene, self._empty = EmbreeScene(), len(mesh.faces) == 0
        self._middle = np.zeros(3) if self._empty else mesh.bounds.mean(0)
        if not self._empty:
            corners = self._local(mesh.vertices)
            self._mesh = TriangleMesh(self._scene, corners, np.asarray(mesh.faces, np.int32))

    def _local(self, points: np.ndarray) -> np.ndarray:
        return np.asarray(points - self._middle, np.float32)

    def first_hit(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Index of the first face on each ray, -1 for none: int [N]."""
        if self._empty:
            return np.full(len(origins), -1)
        return np.asarray(self._scene.run(self._local(origins), directions.astype(np.float32)))

    def openness(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Ambient light: 1 where rays from a point meet nothing nearby, 0.25 where all do: [N]."""
        rng = np.random.default_rng(0)
        start, normals = self._local(points + 5e-3 * normals), normals.astype(np.float32)
        reach = np.full(len(points), AMBIENT_REACH, np.float32)
        free = np.zeros(len(points))
        for _ in range(AMBIENT_RAYS if len(points) else 0):
            # a normal plus a random unit vector is cosine-distributed about the normal
            random = rng.standard_normal(normals.shape, np.float32)
            direction = _unit(normals + _unit(random))
            free += self._scene.run(start, direction, dists=reach, query="OCCLUDED") != 0
        return 0.25 + 0.75 * free / AMBIENT_RAYS


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors [N, 3] at length 1, in their own precision."""
    return vectors / np.sqrt(np.einsum("ij,ij->i", vectors, vectors))[:, None]


def _brightness(rays: _Rays, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Light on surface points [N, 3] with unit normals [N, 3]: [N]."""
    key = np.clip(normals @ trimesh.unitize(LIGHT), 0, 1)
    sky = 0.5 + 0.5 * normals[:, 2]
    return 0.38 * key + (0.42 + 0.32 * sky) * rays.openness(points, normals)


def shade(hits: Hits, color: np.ndarray) -> np.ndarray:
    """The picture of the hits in a colour [3] or colours [N, 3] in [0, 1]: uint8 [h, w, 3]."""
    image = np.ones((*hits.shape, 3))
    colors = np.broadcast_to(color, hits.points.shape) * hits.brightness[:, None]
    image[hits.samples[:, 0], hits.samples[:, 1]] = np.clip(colors, 0, 1)
    height, width = hits.shape
    image = image.reshape(height // FINE, FINE, width // FINE, FINE, 3).mean((1, 3))
    return np.round(255 * image).astype(np.uint8)
