"""Rendering: rays through pixel centres, anti-aliased colours, exact depth, a camera's flaws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial.transform import Rotation

from tf_lab.data.rooms.layout import Plan
from tf_lab.data.rooms.materials import Textures
from tf_lab.data.rooms.shapes import RoomGeometry

Rng = np.random.Generator
BLURRED = 0.04  # the share of frames with motion blur


@dataclass(frozen=True)
class Lighting:
    """Point lights [L, 3] and colours [L, 3] (two cast shadows), ambient light [3], exposure."""

    positions: np.ndarray
    colours: np.ndarray
    ambient: np.ndarray
    exposure: float


@dataclass(frozen=True)
class Hits:
    """Where rays end: faces [N] (-1: nowhere), camera z [N] and world points [N, 3]; metres.

    ``origin`` is where they start: one [3] for all, or [N, 3].
    """

    face: np.ndarray
    depth: np.ndarray
    point: np.ndarray
    origin: np.ndarray


class Renderer:
    """Casts rays into rooms.

    A camera is a pose [4, 4], or the poses [H, 4, 4] at which the rows of the image are exposed.

    Args:
        geometry: the rooms' triangles.
        textures: their materials.
        lighting: each room's lights.
        K: [3, 3] intrinsics; pixel centres at integers.
        size: (width, height).
        samples: samples * samples rays for a pixel on an edge.
    """

    def __init__(
        self,
        geometry: RoomGeometry,
        textures: Textures,
        lighting: Sequence[Lighting],
        K: np.ndarray,
        size: tuple[int, int],
        samples: int,
    ) -> None:
        self._geometry, self._textures, self._lights = geometry, textures, lighting
        self.scene = EmbreeScene()
        corners = geometry.vertices[geometry.faces]
        self._mesh = TriangleMesh(self.scene, corners.astype(np.float32))
        self._plane = np.einsum("fi,fi->f", geometry.normals, corners[:, 0])
        self._size, self._focal = size, float(K[0, 0])
        u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
        self._pixels = np.stack([u, v], axis=-1).reshape(-1, 2).astype(float)
        self._unproject = np.linalg.inv(K).T
        grid = (np.arange(samples) + 0.5) / samples - 0.5
        self._jitter = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)

    def _cast(self, camera: np.ndarray, pixels: np.ndarray) -> Hits:
        """What is seen at pixels [N, 2]."""
        ray = np.column_stack([pixels, np.ones(len(pixels))]) @ self._unproject
        if camera.ndim == 2:
            origin, direction = camera[:3, 3], ray @ camera[:3, :3].T
        else:
            row = pixels[:, 1].round().astype(int)
            origin = camera[row, :3, 3]
            direction = np.einsum("nij,nj->ni", camera[row, :3, :3], ray)
        start = np.broadcast_to(origin.astype(np.float32), direction.shape)
        face = self.scene.run(np.ascontiguousarray(start), direction.astype(np.float32))
        normal = self._geometry.normals[face]
        # the exact plane, not embree's float32 distance
        slope = np.einsum("ni,ni->n", normal, direction)
        offset = normal @ origin if origin.ndim == 1 else np.einsum("ni,ni->n", normal, origin)
        depth = (self._plane[face] - offset) / slope
        return Hits(face, depth, origin + depth[:, None] * direction, origin)

    def _shade(self, hits: Hits) -> tuple[np.ndarray, np.ndarray]:
        """Linear colours [N, 3] of hits, and which shadows fall on them [N]."""
        g, face, depth, point = self._geometry, hits.face, hits.depth, hits.point
        normal = g.normals[face]
        view = hits.origin - point
        view /= np.linalg.norm(view, axis=1, keepdims=True)
        cosine = np.einsum("ni,ni->n", view, normal)
        normal[g.thin[face] & (cosine < 0)] *= -1
        cosine = np.abs(cosine)
        frame = g.uv[face]
        uv = np.einsum("nij,nj->ni", frame[:, :, :3], point) + frame[:, :, 3]
        footprint = depth / self._focal / np.sqrt(np.maximum(cosine, 0.1))
        albedo = self._textures.lookup(g.material[face], uv, footprint) * g.tint[face]
        irradiance, lit = np.empty((len(face), 3)), np.empty(len(face), np.int32)
        rooms = g.room[face]
        for room in np.unique(rooms):
            here = rooms == room
            irradiance[here], lit[here] = self._irradiance(
                self._lights[room], point[here], normal[here]
            )
        return albedo * (irradiance + g.glow[face][:, None]), lit

    def _irradiance(
        self, light: Lighting, point: np.ndarray, normal: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Light [N, 3] that falls on points of a room, and which of its lights reach them [N]."""
        irradiance = light.ambient * (1 + 0.25 * normal[:, 2:])
        lit = np.zeros(len(point), np.int32)
        start = (point + 0.004 * normal).astype(np.float32)
        for number, (position, colour) in enumerate(
            zip(light.positions, light.colours, strict=True)
        ):
            away = position - start
            distance = np.linalg.norm(away, axis=1, keepdims=True)
            incidence = np.einsum("ni,ni->n", away, normal)[:, None] / distance
            gain = np.maximum(incidence, 0) / (0.6 + distance**2)
            if number < 2:
                reach = np.maximum(distance[:, 0] - 0.35, 0.01).astype(np.float32)
                ray = (away / distance).astype(np.float32)
                reached = self.scene.run(start, ray, dists=reach, query="OCCLUDED") != 0
                gain = gain * reached[:, None]
                lit += reached * (number + 1)
            irradiance = irradiance + gain * colour
        return irradiance, lit

    def depth(self, camera: np.ndarray) -> np.ndarray:
        """Depth float32 [H, W]: camera z (m) of what the pixels' centres see; 0: nothing."""
        return self._depth(self._cast(camera, self._pixels))

    def _depth(self, hits: Hits) -> np.ndarray:
        depth = np.where(hits.face >= 0, hits.depth, 0).astype(np.float32)
        return depth.reshape(self._size[::-1])

    def render(self, camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Linear colour [H, W, 3] and depth float32 [H, W] (see `depth`)."""
        width, height = self._size
        hits = self._cast(camera, self._pixels)
        colour, lit = self._shade(hits)
        flat = (4 * self._geometry.flat[hits.face] + lit).reshape(height, width)
        edge = (maximum_filter(flat, 3) != minimum_filter(flat, 3)).ravel()
        if len(self._jitter) > 1 and edge.any():
            finer = (self._pixels[edge][:, None] + self._jitter).reshape(-1, 2)
            some, _ = self._shade(self._cast(camera, finer))
            colour[edge] = some.reshape(-1, len(self._jitter), 3).mean(axis=1)
        return colour.reshape(height, width, 3), self._depth(hits)

    def film(self, pose: np.ndarray, before: np.ndarray, rng: Rng) -> tuple[np.ndarray, np.ndarray]:
        """A photograph uint8 [H, W, 3] and its depth [H, W] (m); some are blurred by motion.

        Args:
            pose: world_T_cam [4, 4].
            before: the previous frame's pose: where the motion comes from.
            rng: the random source.
        """
        linear, depth = self.render(pose)
        if rng.random() < BLURRED:
            around = [self.render(p)[0] for p in _moving(before, pose, rng.uniform(0.05, 0.15))]
            linear = (linear + sum(around)) / (1 + len(around))
        return develop(linear, self._lights[0].exposure * rng.uniform(0.95, 1.05), rng), depth


def _moving(before: np.ndarray, pose: np.ndarray, share: float) -> list[np.ndarray]:
    """Two poses a share of the last step before and after a pose."""
    turn = Rotation.from_matrix(before[:3, :3].T @ pose[:3, :3]).as_rotvec()
    found = []
    for part in (-share, share):
        moved = pose.copy()
        moved[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(part * turn).as_matrix()
        moved[:3, 3] += part * (pose[:3, 3] - before[:3, 3])
        found.append(moved)
    return found


def make_lighting(plan: Plan, rng: Rng) -> Lighting:
    """A lamp below the ceiling, a light at every window, warm or cold; exposed for the whole."""
    x0, y0, x1, y1 = plan.rects[0]
    xy = np.array([x0, y0]) + rng.uniform(0.35, 0.65, 2) * [x1 - x0, y1 - y0]
    drop = min(rng.uniform(0.3, 0.55), plan.height - 2.2)  # well above the camera
    positions = [np.array([*xy, plan.height - drop])]
    warm = 1 + rng.uniform(-0.05, 0.3) * np.array([1, 0.1, -1])
    colours = [rng.uniform(1.2, 2.6) * warm]
    day = rng.uniform(0.2, 1.6) * (1 + rng.uniform(-0.05, 0.2) * np.array([-1, 0, 1]))
    for wall in plan.walls:
        along = (wall.b - wall.a) / wall.length
        for o in wall.openings:
            if o.kind == "window":
                spot = (
                    wall.a + along * (o.start + o.end) / 2 + 0.2 * np.array([-along[1], along[0]])
                )
                positions.append(np.array([*spot, (o.low + o.high) / 2 + 0.1]))
                colours.append(day)
    ambient = rng.uniform(0.28, 0.5) * (1 + 0.5 * (warm - 1))
    balance = 1 + rng.uniform(-0.06, 0.06, 3)  # what the camera's white balance leaves
    light = Lighting(np.array(positions), np.array(colours) * balance, ambient * balance, 1.0)
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 1.0])
    gap = ((light.positions - middle) ** 2).sum(axis=1)
    typical = float(light.ambient.mean() + (0.5 * light.colours.mean(axis=1) / (0.6 + gap)).sum())
    return replace(light, exposure=rng.uniform(0.7, 1.15) / typical * 0.75)


def develop(linear: np.ndarray, exposure: float | np.ndarray, rng: Rng) -> np.ndarray:
    """A sensor: vignette, shot and read noise, gamma; linear [H, W, 3] to uint8.

    ``exposure`` is one gain, or one a channel [3].
    """
    height, width = linear.shape[:2]
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    image = linear * exposure * (1 - 0.12 * (x**2 + y**2) / 2)[..., None]
    image = image / (1 + 0.35 * np.maximum(image - 0.5, 0))  # highlights roll off
    image += rng.standard_normal(image.shape) * (0.004 + 0.012 * np.sqrt(np.maximum(image, 0)))
    return (np.clip(image, 0, 1) ** (1 / 2.2) * 255).round().astype(np.uint8)
