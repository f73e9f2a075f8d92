"""Ground truth of a scene from its depth maps: what training and evaluation compare with.

Layout of a ``groundtruth`` directory::

    mesh_gt.ply          the surface                                  } the published
    occlusion_mask.npy   uint8 [X,Y,Z], 1 = never observed            } evaluation layout
    world2grid.txt       4x4, metres -> voxel indices (centres at integers) }
    sdf.npy              float16 [X,Y,Z], signed distance (m) to the seen surface, + in front;
                         NaN where unknown
    distance.npy         float16 [X,Y,Z], distance (m) to the nearest surface, at most MAX_DISTANCE
    chunks.npz           centers [M,3] (m) and weight [M]: where to train, see `chunk_candidates`
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
from scipy.spatial import cKDTree
from torch import Tensor

from tf_lab.data.capture import Capture
from tf_lab.data.tsdf import TSDF, bounds_of, extract_mesh, fuse
from tf_lab.errors import TFLabError
from tf_lab.geometry import VoxelGrid, in_view, invert_pose, project

VERSION = 2  # changes whenever the output for the same depth does
EMPTY_SHARE = 0.2
MAX_DISTANCE = 0.5  # metres, largest value in distance.npy
MAX_READING = 10.0  # metres, farthest depth that counts as seen
COARSE, FINE, CHUNK = 0.30, 0.10, 1.5  # metres; the paper's v_c, v_f and chunk edge


@dataclass(frozen=True)
class GroundTruthSettings:
    """How depth is fused: voxel edge, truncation and farthest reading, all in metres."""

    voxel: float = 0.04
    truncation: float = 0.12
    far: float = 6.0


def depth_maps(capture: Capture, indices: range | list[int]) -> Iterator[Tensor]:
    """The depth maps [h, w] of some frames, one at a time.

    Raises:
        TFLabError: a frame has no depth.
    """
    for i in indices:
        depth = capture.depth(i)
        if depth is None:
            raise TFLabError(f"{capture.name}: frame {capture.frames[i]} has no depth")
        yield torch.from_numpy(depth)


def fuse_capture(capture: Capture, settings: GroundTruthSettings) -> TSDF:
    """The TSDF of all depth maps of a capture, on a grid that holds all that is near a surface."""
    n = range(len(capture.frames))
    K = torch.from_numpy(capture.K).float()
    poses = torch.from_numpy(capture.world_T_cam).float()

    def depths() -> Iterator[Tensor]:
        return (torch.where(d > settings.far, 0.0, d) for d in depth_maps(capture, n))

    margin = max(settings.truncation, COARSE) + settings.voxel
    lower, upper = bounds_of(depths(), K, poses, margin)
    grid = VoxelGrid.covering(lower.tolist(), upper.tolist(), settings.voxel)
    return fuse(depths(), K, poses, grid, settings.truncation, settings.far)


def signed_distance(tsdf: TSDF) -> Tensor:
    """Signed distance [X, Y, Z] in metres, NaN where unknown.

    A voxel behind a seen surface is unknown, unless its whole vertical column was never observed:
    then it is solid (the rule of Atlas, Murez et al. 2020; paper, Sec. 3.3).
    """
    observed = tsdf.weight > 0
    sdf = torch.where(observed, tsdf.distance, torch.full_like(tsdf.distance, torch.nan))
    hidden_columns = ~observed.any(dim=2, keepdim=True)
    return torch.where(hidden_columns, torch.full_like(sdf, -tsdf.truncation), sdf)


def surface_distance(mesh: trimesh.Trimesh, grid: VoxelGrid) -> Tensor:
    """Distance [X, Y, Z] in metres from voxel centres to the nearest mesh vertex, capped."""
    tree = cKDTree(np.asarray(mesh.vertices))
    centers = grid.centers().reshape(-1, 3).numpy()
    distance, _ = tree.query(centers, distance_upper_bound=MAX_DISTANCE)
    return torch.from_numpy(np.minimum(distance, MAX_DISTANCE)).float().reshape(grid.shape)


def chunk_candidates(
    mesh: trimesh.Trimesh, grid: VoxelGrid, stride: float = COARSE
) -> tuple[np.ndarray, np.ndarray]:
    """Chunk centres and their sampling weights: fewer in free space, more with furniture.

    Without labels, structure is told by shape: surface in columns that are covered over most of
    the scene's height is wall, surface near the lowest or highest level is floor or ceiling; what
    remains is furniture. Weights: 1 with structure only, rising to 3 with the share of furniture.
    Chunks without surface, in the scene or up to a chunk beyond it (where frusta reach at test
    time), get little: 0.15, and together at most EMPTY_SHARE of all others.

    Returns:
        centers float32 [M, 3] in metres, weight float32 [M].
    """
    vertices = np.asarray(mesh.vertices)
    lower, upper = vertices.min(0), vertices.max(0)
    cell = np.floor((vertices[:, :2] - lower[:2]) / FINE).astype(int)
    level = np.floor((vertices[:, 2] - lower[2]) / FINE).astype(int)
    shape = (*(cell.max(0) + 1), level.max() + 1)
    occupied = np.zeros(shape, bool)
    occupied[cell[:, 0], cell[:, 1], level] = True
    wall = occupied.sum(2) > 0.5 * shape[2]
    floor, ceiling = np.quantile(vertices[:, 2], [0.02, 0.98])
    flat = (vertices[:, 2] < floor + 0.15) | (vertices[:, 2] > ceiling - 0.15)
    furniture = ~wall[cell[:, 0], cell[:, 1]] & ~flat

    half = CHUNK / 2
    axes = [np.arange(a - CHUNK, b + CHUNK, stride) for a, b in zip(lower, upper, strict=True)]
    centers = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    # counts of vertices in the box around each centre, by the max norm
    everything = cKDTree(vertices).query_ball_point(
        centers, half, p=np.inf, return_length=True, workers=1
    )
    if furniture.any():
        things = cKDTree(vertices[furniture]).query_ball_point(
            centers, half, p=np.inf, return_length=True, workers=1
        )
    else:
        things = np.zeros(len(centers), int)
    some = (CHUNK / grid.voxel) ** 2 * 0.1  # a tenth of one plane through the chunk
    share = np.minimum(things / (2 * some), 1.0)
    weight = 1.0 + 2.0 * share
    empty = everything < some
    if not empty.all():
        weight[empty] = min(EMPTY_SHARE * weight[~empty].sum() / max(1, empty.sum()), 0.15)
    return centers.astype(np.float32), weight.astype(np.float32)


def write_groundtruth(capture: Capture, directory: Path, settings: GroundTruthSettings) -> None:
    """Fuse a capture's depth and write its ground truth (not atomic; see `files`).

    Raises:
        TFLabError: the depth maps give no surface.
    """
    tsdf = fuse_capture(capture, settings)
    mesh = extract_mesh(tsdf)
    if not len(mesh.faces):
        raise TFLabError(f"{capture.name}: the depth maps give no surface; check depth and poses")
    directory.mkdir(parents=True, exist_ok=True)
    mesh.export(directory / "mesh_gt.ply")
    np.save(directory / "occlusion_mask.npy", (tsdf.weight == 0).numpy().astype(np.uint8))
    np.savetxt(directory / "world2grid.txt", torch.linalg.inv(tsdf.grid.world_T_index).numpy())
    np.save(directory / "sdf.npy", signed_distance(tsdf).numpy().astype(np.float16))
    distance = surface_distance(mesh, tsdf.grid)
    np.save(directory / "distance.npy", distance.numpy().astype(np.float16))
    centers, weight = chunk_candidates(mesh, tsdf.grid)
    np.savez(directory / "chunks.npz", centers=centers, weight=weight)


def views_per_point(
    capture: Capture, frames: list[int], mesh: trimesh.Trimesh, tolerance: float = 0.05
) -> np.ndarray:
    """How many of the frames see each mesh vertex, told by their depth: int64 [V].

    Args:
        capture: with depth.
        frames: indices of the frames to count.
        mesh: metres.
        tolerance: largest difference (metres) between the reading and the vertex' depth.
    """
    vertices = torch.from_numpy(np.asarray(mesh.vertices)).float()
    counts = torch.zeros(len(vertices), dtype=torch.int64)
    for i, depth in zip(frames, depth_maps(capture, frames), strict=True):
        pose = torch.from_numpy(capture.world_T_cam[i]).float()
        uv, z = project(vertices, torch.from_numpy(capture.K[i]).float(), invert_pose(pose))
        size = (depth.shape[1], depth.shape[0])
        seen = in_view(uv, z, size, 0.05, MAX_READING).nonzero().squeeze(1)
        u, v = uv[seen].round().long().unbind(-1)
        counts[seen] += ((depth[v, u] - z[seen]).abs() < tolerance).long()
    return counts.numpy()


class GroundTruth:
    """A ground-truth directory, opened; volumes are memory-mapped and read where asked for.

    Raises:
        TFLabError: a file is missing or damaged.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        try:
            self.sdf_volume = np.load(directory / "sdf.npy", mmap_mode="r")
            self.distance_volume = np.load(directory / "distance.npy", mmap_mode="r")
            world2grid = np.loadtxt(directory / "world2grid.txt").reshape(4, 4)
            with np.load(directory / "chunks.npz") as chunks:
                self.centers, self.weight = chunks["centers"], chunks["weight"]
            shape = self.sdf_volume.shape
            if len(shape) != 3 or shape != self.distance_volume.shape:
                raise ValueError(f"volumes of {shape} and {self.distance_volume.shape}")
        except Exception as error:  # any damage: missing, truncated, wrong shape
            raise TFLabError(
                f"{directory}: the ground truth is damaged ({error}); delete the scene and "
                "prepare it again"
            ) from error
        voxel = 1 / world2grid[0, 0]
        origin = -(world2grid[:3, 3] + 0.5) * voxel
        self.grid = VoxelGrid(
            (float(origin[0]), float(origin[1]), float(origin[2])),
            float(voxel),
            (shape[0], shape[1], shape[2]),
        )

    def signed_distance(self, points: Tensor) -> Tensor:
        """Trilinear signed distance [P] in metres at points [P, 3]; NaN where unknown."""
        return self._sample(self.sdf_volume, points, float("nan"))

    def surface_distance(self, points: Tensor) -> Tensor:
        """Trilinear distance [P] in metres to the surface at points [P, 3], capped."""
        return self._sample(self.distance_volume, points, MAX_DISTANCE)

    def _sample(self, volume: np.ndarray, points: Tensor, outside: float) -> Tensor:
        """Read the block around the points, then interpolate in it."""
        index = self.grid.to_index(points)
        shape = torch.tensor(self.grid.shape)
        low = torch.minimum(index.amin(0).floor().long().clamp(min=0), shape - 2)
        high = torch.minimum(torch.maximum(index.amax(0).floor().long(), low) + 2, shape)
        x, y, z = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
        block = torch.from_numpy(np.ascontiguousarray(volume[x, y, z]).astype(np.float32))
        part = self.grid.block(low.tolist(), high.tolist())
        values = part.sample(block[None], points)[:, 0]
        inside = ((index >= -0.5) & (index <= shape - 0.5)).all(-1)
        return torch.where(inside, values, torch.full_like(values, outside))
