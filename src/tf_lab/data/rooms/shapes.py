"""Surfaces of a room: polygons, boxes, lathed solids; each face with a material and a uv frame.

A uv frame maps a hit point (metres, world) to metres on the face, so that a texture keeps its real
size on any face and nothing has to be unwrapped.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh

Vector = Sequence[float] | np.ndarray
Tint = Sequence[float] | np.ndarray
WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class RoomGeometry:
    """Every triangle of a room.

    Attributes:
        vertices: float64 [V, 3] metres.
        faces: int32 [F, 3], counter-clockwise seen from the visible side.
        normals: float64 [F, 3], unit.
        flat: int32 [F], the flat piece that a triangle belongs to.
        material: int32 [F].
        tint: float32 [F, 3], multiplies the material's colour.
        glow: float32 [F], emitted light (0: none).
        uv: float64 [F, 2, 4], maps (x, y, z, 1) to metres on the face.
        room: int32 [F], the room that a triangle belongs to.
        thin: bool [F], seen from both sides.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    flat: np.ndarray
    material: np.ndarray
    tint: np.ndarray
    glow: np.ndarray
    uv: np.ndarray
    room: np.ndarray
    thin: np.ndarray

    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Points [count, 3] spread evenly over the surface, 1 cm before it."""
        a, b, c = self.vertices[self.faces].transpose(1, 0, 2)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        face = rng.choice(len(area), count, p=area / area.sum())
        s, t = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
        return (1 - s) * a[face] + s * ((1 - t) * b[face] + t * c[face]) + 0.01 * self.normals[face]

    def mesh(self) -> trimesh.Trimesh:
        """The same triangles as a mesh, in the same order."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)


class Surfaces:
    """Collects faces; a local frame (yaw and offset) is in force inside `at`.

    Attributes:
        rng: the random source.
        room: what the faces that are added from now on belong to.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.room = 0
        self._rotation, self._offset = np.eye(3), np.zeros(3)
        self._vertices: list[np.ndarray] = []
        self._faces: list[tuple[int, int, int]] = []
        self._rows: list[tuple[np.ndarray, int, int, Tint, float, np.ndarray, int, bool]] = []
        self._count = 0
        self._flats = 0

    @contextmanager
    def at(self, offset: Vector, yaw: float = 0.0) -> Iterator[None]:
        """Work in a frame turned by ``yaw`` (radians, about z) and moved by ``offset`` (metres)."""
        saved = self._rotation, self._offset
        c, s = np.cos(yaw), np.sin(yaw)
        self._offset = saved[0] @ np.asarray(offset, float) + saved[1]
        self._rotation = saved[0] @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        try:
            yield
        finally:
            self._rotation, self._offset = saved

    def polygon(
        self,
        corners: np.ndarray,
        material: int,
        tint: Tint = WHITE,
        glow: float = 0.0,
        u_axis: Vector | None = None,
        triangles: Sequence[tuple[int, int, int]] | None = None,
        uv_start: Vector | None = None,
    ) -> None:
        """A flat convex polygon, corners [N, 3] counter-clockwise seen from its visible side.

        u runs along ``u_axis`` (default: the first edge); a polygon that is not convex needs its
        ``triangles``. ``uv_start`` [2] is the uv of the first corner (default: random).
        """
        points = np.asarray(corners, float) @ self._rotation.T + self._offset
        normal = _unit(_cross(points[1] - points[0], points[2] - points[1]))
        u = points[1] - points[0] if u_axis is None else self._rotation @ np.asarray(u_axis, float)
        u = _unit(u)
        axes = np.stack([u, _cross(normal, u)])
        start = self.rng.uniform(0, 8, 2) if uv_start is None else np.asarray(uv_start, float)
        shift = start - axes @ points[0]
        frame = np.concatenate([axes, shift[:, None]], axis=1)
        fan = triangles or [(0, i, i + 1) for i in range(1, len(points) - 1)]
        for a, b, c in fan:
            self._faces.append((self._count + a, self._count + b, self._count + c))
            self._rows.append((normal, self._flats, material, tint, glow, frame, self.room, False))
        self._vertices.append(points)
        self._count += len(points)
        self._flats += 1

    def triangles(
        self, corners: np.ndarray, material: int, tint: Tint = WHITE, uv: np.ndarray | None = None
    ) -> None:
        """Triangles of a model, seen from both sides: corners [F, 3, 3], none without area.

        ``uv`` [F, 3, 2] (m) is where the corners are on the material; without it, it lies on each
        triangle in its real size.
        """
        points = corners @ self._rotation.T + self._offset
        first, along = points[:, 0], points[:, 1:] - points[:, :1]
        normals = np.cross(along[:, 0], along[:, 1])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        if uv is None:
            level = np.abs(normals[:, 2:]) > 0.9
            u = np.cross(np.where(level, [0, 1.0, 0], [0, 0, 1.0]), normals)
            u /= np.linalg.norm(u, axis=1, keepdims=True)
            axes, start = np.stack([u, np.cross(normals, u)], axis=1), 0.0
        else:
            edges = np.concatenate([along, normals[:, None]], axis=1)  # along normals uv stays
            change = np.zeros_like(edges[..., :2])
            change[:, :2] = uv[:, 1:] - uv[:, :1]
            axes = np.linalg.solve(edges, change).transpose(0, 2, 1)
            start = uv[:, 0] - np.einsum("fij,fj->fi", axes, first)
        frames = np.zeros((len(points), 2, 4))
        frames[:, :, :3], frames[:, :, 3] = axes, start
        for k, (normal, frame) in enumerate(zip(normals, frames, strict=True)):
            a = self._count + 3 * k
            self._faces.append((a, a + 1, a + 2))
            flat = self._flats + k
            self._rows.append((normal, flat, material, tint, 0.0, frame, self.room, True))
        self._vertices.append(points.reshape(-1, 3))
        self._count += 3 * len(points)
        self._flats += len(points)

    def box(
        self,
        low: Vector,
        high: Vector,
        material: int,
        tint: Tint = WHITE,
        glow: float = 0.0,
        skip: str = "",
    ) -> None:
        """An axis-aligned box (in the local frame) without the faces named in ``skip``.

        Faces are x- x+ y- y+ z- z+, given as a string such as "z- y-". On each face u runs along
        the box's longer edge, as grain does.
        """
        low, high = np.asarray(low, float), np.asarray(high, float)
        for axis in range(3):
            others = [(axis + 1) % 3, (axis + 2) % 3]
            for side, name in ((0, "-"), (1, "+")):
                if f"{'xyz'[axis]}{name}" in skip.split():
                    continue
                a, b = others if side else others[::-1]
                corners = np.tile((low, high)[side], (4, 1))
                corners[:, a] = [low[a], high[a], high[a], low[a]]
                corners[:, b] = [low[b], low[b], high[b], high[b]]
                long = a if high[a] - low[a] >= high[b] - low[b] else b
                self.polygon(corners, material, tint, glow, u_axis=np.eye(3)[long])

    def lathe(
        self,
        profile: Sequence[tuple[float, float]],
        material: int,
        tint: Tint = WHITE,
        glow: float = 0.0,
        sides: int = 12,
        double: bool = False,
    ) -> None:
        """A solid of revolution about the local z axis from (radius, height) pairs, upwards.

        ``double`` shows its inside too (a lamp shade).
        """
        turn = np.linspace(0, 2 * np.pi, sides + 1)
        ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        start = self.rng.uniform(0, 8, 2)
        for (r0, z0), (r1, z1) in pairwise(profile):
            for k in range(sides):
                corners = np.array(
                    [
                        [*(r0 * ring[k]), z0],
                        [*(r0 * ring[k + 1]), z0],
                        [*(r1 * ring[k + 1]), z1],
                        [*(r1 * ring[k]), z1],
                    ]
                )
                if r0 < 1e-6:
                    corners = corners[[0, 2, 3]]
                elif r1 < 1e-6:
                    corners = corners[:3]
                uv = start + np.array([2 * np.pi * max(r0, r1) * k / sides, z0])
                self.polygon(corners, material, tint, glow, uv_start=uv)
                if double:  # 4 mm inside: coincident faces would flicker
                    inside = corners[::-1] * [1 - 0.004 / r0, 1 - 0.004 / r0, 1]
                    self.polygon(inside, material, tint, glow)

    def build(self) -> RoomGeometry:
        """Everything collected so far."""
        normal, flat, material, tint, glow, frame, room, thin = zip(*self._rows, strict=True)
        return RoomGeometry(
            np.concatenate(self._vertices),
            np.asarray(self._faces, np.int32),
            np.asarray(normal),
            np.asarray(flat, np.int32),
            np.asarray(material, np.int32),
            np.asarray(tint, np.float32),
            np.asarray(glow, np.float32),
            np.asarray(frame),
            np.asarray(room, np.int32),
            np.asarray(thin, bool),
        )


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product of vectors [3]; a tenth of the time of numpy's, which takes stacks."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _unit(a: np.ndarray) -> np.ndarray:
    return a / math.sqrt(a.dot(a))
