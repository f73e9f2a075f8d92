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

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
from scipy.spatial import cKDTree
from torch import Tensor
from trimesh.remesh import subdivide_to_size

from tf_lab.data.capture import Capture
from tf_lab.data.chunk_weights import Structure, chunk_candidates
from tf_lab.data.tsdf import TSDF, bounds_of, extract_mesh, fuse_in_slabs, join, slabs
from tf_lab.errors import TFLabError
from tf_lab.geometry import COARSE, VoxelGrid
from tf_lab.support.arrays import TooManyFilesError, read_array, read_arrays
from tf_lab.support.layout import GROUNDTRUTH_MESH, OCCLUSION_MASK, WORLD2GRID
from tf_lab.support.text import read_numbers

VERSION = 3  # changes whenever the output for the same depth does; of a given mesh, captures'
MAX_DISTANCE = 0.4  # metres, largest value in distance.npy
MAX_READING = 10.0  # metres, farthest depth that counts as seen
CURE = "delete the scene and prepare it again"
MAX_HALVINGS = 20  # of an edge of a given mesh: as long as a large house may be
MAX_VOXELS = 4_000_000_000  # a larger volume is no indoor scene: some pose is wrong


@dataclass(frozen=True)
class GroundTruthSettings:
    """How depth is fused: voxel edge, truncation and farthest reading, all in metres."""

    voxel: float = 0.04
    truncation: float = 0.12
    far: float = 6.0


class DepthMaps(Sequence[Tensor]):
    """The depth maps [h, w] of a capture's frames, read when asked for; beyond ``far``: 0.

    Raises:
        TFLabError: on asking for a frame that has no depth.
    """

    def __init__(self, capture: Capture, frames: Sequence[int], far: float = MAX_READING) -> None:
        self.capture, self.frames, self.far = capture, frames, far

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, i: int) -> Tensor:  # type: ignore[override]
        """The depth map of the i-th of the frames."""
        depth = self.capture.depth(self.frames[i])
        if depth is None:
            name = self.capture.frames[self.frames[i]]
            raise TFLabError(f"{self.capture.name}: frame {name} has no depth")
        return torch.from_numpy(np.where(depth > self.far, np.float32(0), depth))


def fuse_capture(
    capture: Capture,
    settings: GroundTruthSettings,
    memory: int = 2**30,
    device: torch.device | str = "cpu",
    frames: Sequence[int] | None = None,
) -> tuple[VoxelGrid, Iterator[tuple[int, TSDF]]]:
    """Depth maps of a capture (all or some) fused on a grid that holds all near a surface.

    Returns:
        The grid, and its slabs as `fuse_in_slabs` gives them.
    """
    chosen = list(range(len(capture.frames)) if frames is None else frames)
    K = torch.from_numpy(capture.K[chosen]).float()
    poses = torch.from_numpy(capture.world_T_cam[chosen]).float()
    depths = DepthMaps(capture, chosen, settings.far)
    margin = max(settings.truncation, COARSE) + settings.voxel
    lower, upper = bounds_of(depths, K, poses, margin)
    grid = VoxelGrid.covering(lower.tolist(), upper.tolist(), settings.voxel)
    if math.prod(grid.shape) > MAX_VOXELS:
        size = " x ".join(f"{n * grid.voxel:.0f}" for n in grid.shape)
        raise TFLabError(
            f"{capture.name}: the depth readings span {size} m; the poses or the depth unit "
            "must be wrong"
        )
    fused = fuse_in_slabs(depths, K, poses, grid, settings.truncation, settings.far, memory, device)
    return grid, fused


def signed_distance(tsdf: TSDF) -> Tensor:
    """Signed distance [X, Y, Z] in metres, NaN where unknown.

    A voxel behind a seen surface is unknown, unless its whole vertical column was never observed:
    then it is solid (the rule of Atlas, Murez et al. 2020; paper, Sec. 3.3).
    """
    observed = tsdf.weight > 0
    sdf = torch.where(observed, tsdf.distance, torch.full_like(tsdf.distance, torch.nan))
    hidden_columns = ~observed.any(dim=2, keepdim=True)
    return torch.where(hidden_columns, torch.full_like(sdf, -tsdf.truncation), sdf)


def _tree(mesh: trimesh.Trimesh) -> cKDTree:
    """Of the vertices; not balanced: voxels, which are evenly spread, are twice as fast so."""
    return cKDTree(np.asarray(mesh.vertices), balanced_tree=False, compact_nodes=False)


def dense(mesh: trimesh.Trimesh, spacing: float) -> trimesh.Trimesh:
    """A mesh without edges longer than ``spacing`` (metres), so that vertices stand for faces."""
    vertices, faces = subdivide_to_size(mesh.vertices, mesh.faces, spacing, max_iter=MAX_HALVINGS)
    return trimesh.Trimesh(vertices, faces)  # merges vertices that faces share


def surface_distance(vertices: cKDTree, grid: VoxelGrid) -> Tensor:
    """Distance [X, Y, Z] in metres from voxel centres to the nearest of the vertices, capped."""
    centers = grid.centers().reshape(-1, 3).numpy()
    distance, _ = vertices.query(centers, distance_upper_bound=MAX_DISTANCE)
    return torch.from_numpy(np.minimum(distance, MAX_DISTANCE)).float().reshape(grid.shape)


def write_groundtruth(
    capture: Capture,
    directory: Path,
    settings: GroundTruthSettings,
    mesh: trimesh.Trimesh | None = None,
    structure: Structure | None = None,
    memory: int = 2**30,
    device: torch.device | str = "cpu",
    frames: Sequence[int] | None = None,
    training: bool = True,
) -> None:
    """Fuse a capture's depth and write its ground truth (not atomic; see `files`).

    Args:
        capture: every frame with depth, unless ``frames`` says which have it.
        directory: is made.
        settings: how to fuse.
        mesh: the surface, where the source brings one; None: that of the fused depth.
        structure: what of the surface is floor and wall, where the source says so.
        memory: bytes that the fusion may take.
        device: where to fuse.
        frames: those to fuse; None: all.
        training: with what only training needs: signed distances, distances, centres of chunks.

    Raises:
        TFLabError: the depth maps give no surface.
    """
    grid, fused = fuse_capture(capture, settings, memory, device, frames)
    directory.mkdir(parents=True, exist_ok=True)
    meshes = []
    with (
        _volume(directory / OCCLUSION_MASK, grid, np.uint8) as occlusion,
        _volume(directory / "sdf.npy", grid, np.float16) if training else nullcontext() as sdf,
    ):
        for rows, slab in fused:
            occlusion((slab.weight == 0)[:rows])
            if sdf is not None:
                sdf(signed_distance(slab)[:rows])
            meshes.append(extract_mesh(slab))
    seen = join(meshes)
    surface = seen if mesh is None else mesh
    if not len(surface.faces):
        raise TFLabError(f"{capture.name}: the depth maps give no surface; check depth and poses")
    surface.export(directory / GROUNDTRUTH_MESH)
    np.savetxt(directory / WORLD2GRID, torch.linalg.inv(grid.world_T_index).numpy())
    if not training:
        return
    tree = _tree(seen if mesh is None else dense(mesh, grid.voxel / 2))
    with _volume(directory / "distance.npy", grid, np.float16) as distance:
        for first, last in slabs(grid, memory):
            part = grid.block((first, 0, 0), (last, *grid.shape[1:]))
            distance(surface_distance(tree, part))
    # of vertices as dense as the grid's, which a given mesh's need not be
    centers, weight = chunk_candidates(seen, grid, structure=structure)
    np.savez(directory / "chunks.npz", centers=centers, weight=weight)


@contextmanager
def _volume(path: Path, grid: VoxelGrid, dtype: type) -> Iterator[Callable[[Tensor], None]]:
    """A .npy file of the grid's shape; the function given appends rows [n, Y, Z] to it."""
    header = {"descr": np.dtype(dtype).str, "fortran_order": False, "shape": tuple(grid.shape)}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        yield lambda rows: rows.numpy().astype(dtype).tofile(file)


class GroundTruth:
    """A ground-truth directory, opened; volumes are memory-mapped and read where asked for.

    Raises:
        TFLabError: a file is missing or damaged.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        try:
            self.sdf_volume = read_array(directory / "sdf.npy", CURE)
            self.distance_volume = read_array(directory / "distance.npy", CURE)
            numbers = read_numbers(directory / WORLD2GRID, CURE)
            world2grid = np.array(numbers).reshape(4, 4)
            chunks = read_arrays(directory / "chunks.npz", CURE)
            self.centers, self.weight = chunks["centers"], chunks["weight"]
            shape = self.sdf_volume.shape
            if len(shape) != 3 or shape != self.distance_volume.shape:
                raise ValueError(f"volumes of {shape} and {self.distance_volume.shape}")
            if not (np.isfinite(world2grid).all() and world2grid[0, 0] > 0):
                raise ValueError(f"{WORLD2GRID} is no grid's")
            if self.centers.shape != (len(self.weight), 3):
                raise ValueError("centres and weights in chunks.npz do not fit")
        except TooManyFilesError:
            raise
        except Exception as error:  # any damage: missing, truncated, wrong shape
            raise TFLabError(
                f"{directory}: the ground truth is damaged ({error}); {CURE}"
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
