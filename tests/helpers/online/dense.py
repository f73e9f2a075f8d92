"""The reference for tests: the whole scene in dense volumes, everything computed at mesh().

View sets frame by frame on a grid known beforehand, dense 3D convolutions, one marching cubes.
Shares with `tf_lab.online` the view store and the meshing of a field, and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
import trimesh
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.geometry import (
    COARSE,
    VoxelGrid,
    covered_pixels,
    invert_pose,
    pixel_directions,
    sample_maps,
    transform,
)
from tf_lab.meshes.colors import color_vertices
from tf_lab.meshes.isosurface import mesh_of
from tf_lab.network.network import Network
from tf_lab.network.refinement import upsample
from tf_lab.network.tokens import Measurements, measure
from tf_lab.online.settings import ReconstructionSettings, cells_per_voxel
from tf_lab.online.views import make_policy
from tf_lab.online.views.selection import RandomSelection
from tf_lab.online.views.store import ViewStore
from tf_lab.stereo.cost import View
from tf_lab.stereo.depth import CHANNELS, SETTINGS, depth_of, small_view

COLOR_FRAMES = 60  # evenly chosen frames that paint the mesh
LATTICE = 0.05  # metres; voxel centres of both levels lie on multiples of it


Decode = Callable[[Tensor], Tensor]


def measured(
    network: Network,
    level: str,
    maps: Mapping[str, Tensor],
    points: Tensor,
    K: Tensor,
    world_T_cam: Tensor,
    size: tuple[int, int],
) -> Measurements:
    """What a view with maps [C, h, w] measures at points [P, 3]: [1, P, ...]."""
    depth_range = (network.config.near, network.config.far)
    cameras = (K[None], world_T_cam[None], invert_pose(world_T_cam)[None])

    def sample(uv: Tensor) -> Tensor:
        covered = covered_pixels(maps[level], network.stride[level])
        return sample_maps(maps[level][None], uv, covered)

    def stereo(uv: Tensor) -> Tensor:
        return sample_maps(maps["stereo"][None], uv, size, "nearest")

    told = stereo if network.config.stereo else None
    return measure(points, *cameras, size, depth_range, sample, told)


def embed(
    network: Network,
    level: str,
    maps: Mapping[str, Tensor],
    points: Tensor,
    K: Tensor,
    world_T_cam: Tensor,
    size: tuple[int, int],
) -> Tensor:
    """Tokens [1, P, D] of points [P, 3] in a view with maps [C, h, w]."""
    return network.embed(level, measured(network, level, maps, points, K, world_T_cam, size))


@dataclass
class Volumes:
    """Refined features of a scene, ready to decode.

    Attributes:
        coarse, fine: [D, X, Y, Z] on ``coarse_grid`` and ``fine_grid`` (3 to 1, aligned).
        active: bool, fine voxels in which surface is looked for.
    """

    coarse: Tensor
    coarse_grid: VoxelGrid
    fine: Tensor
    fine_grid: VoxelGrid
    active: Tensor


def frustum_grid(
    K: np.ndarray, world_T_cam: np.ndarray, size: tuple[int, int], far: float
) -> VoxelGrid:
    """The coarse grid that holds all frusta: K [N, 3, 3], poses [N, 4, 4], far in metres."""
    corners = []
    for k, pose in zip(K, world_T_cam, strict=True):
        rays = pixel_directions(torch.from_numpy(k).float(), size)[[0, 0, -1, -1], [0, -1, 0, -1]]
        pose = torch.from_numpy(pose).float()
        corners += [transform(pose, rays * far), pose[None, :3, 3]]
    points = torch.cat(corners)
    low, high = points.amin(0) - COARSE, points.amax(0) + COARSE
    return VoxelGrid.covering(low.tolist(), high.tolist(), COARSE)


class DenseReconstructor:
    """Online reconstruction of one scene.

    Args:
        network: on its device, in evaluation mode.
        grid: coarse voxels of the scene, see `frustum_grid`.
        settings: test-time settings.
    """

    def __init__(
        self,
        network: Network,
        grid: VoxelGrid,
        settings: ReconstructionSettings,
    ) -> None:
        self.network, self.grid, self.settings = network, grid, settings
        self.device = next(network.parameters()).device
        policy = make_policy(settings.select, settings.seed)
        if policy.needs_logits and self._heads("coarse") == 0:
            policy = RandomSelection(settings.seed)
        self.policy = policy
        self.images: list[Tensor] = []
        self.maps: list[dict[str, Tensor]] = []
        self.views: list[View] = []
        self.K: list[Tensor] = []
        self.poses: list[Tensor] = []
        self.points = grid.centers().reshape(-1, 3).to(self.device)
        self.coarse_store = self._store("coarse", self.points)

    @torch.inference_mode()
    def add_frame(self, image: np.ndarray, K: np.ndarray, world_T_cam: np.ndarray) -> None:
        """Add a frame: uint8 [H, W, 3] RGB, its intrinsics [3, 3] and its pose [4, 4].

        Raises:
            TFLabError: the image's size differs from that of the frames before.
        """
        tensor = torch.from_numpy(np.array(image)).permute(2, 0, 1).contiguous()
        if self.images and tensor.shape != self.images[0].shape:
            raise TFLabError(f"a frame of {tensor.shape[2]}x{tensor.shape[1]} among others")
        maps = self.network.encode(tensor[None].to(self.device))
        self.images.append(tensor)
        self.maps.append({level: m[0] for level, m in maps.items()})
        self.K.append(torch.from_numpy(np.array(K)).float().to(self.device))
        self.poses.append(torch.from_numpy(np.array(world_T_cam)).float().to(self.device))
        if self.network.config.stereo:
            camera = (self.K[-1].numpy(), self.poses[-1].numpy())
            self.views.append(small_view(np.array(image), *camera, SETTINGS.width))
            depth = torch.from_numpy(depth_of(self.views, len(self.views) - 1))
            self.maps[-1]["stereo"] = depth.half().float()
        self._select("coarse", self.coarse_store, self.points, len(self.images) - 1)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the frames, pixels."""
        return self.images[0].shape[2], self.images[0].shape[1]

    @torch.inference_mode()
    def mesh(self) -> trimesh.Trimesh:
        """The surface, with vertex colours; no faces if there is none."""
        volumes = self.volumes()
        if volumes is None:
            return trimesh.Trimesh()

        def decode(points: Tensor) -> Tensor:
            v = volumes
            return self.network.decode(
                v.coarse, v.coarse_grid, v.fine, v.fine_grid, points.to(self.device)
            )

        active = volumes.active.cpu()
        if not self.network.config.filter:
            active = crossing_voxels(decode, volumes.fine_grid, active)
        mesh = extract(decode, volumes.fine_grid, active, self.settings.resolution)
        if len(mesh.faces):
            some = np.unique(np.linspace(0, len(self.images) - 1, COLOR_FRAMES).round().astype(int))
            images = [self.images[i] for i in some]
            K, poses = torch.stack(self.K).cpu(), torch.stack(self.poses).cpu()
            color_vertices(mesh, images, K[some], poses[some])
        return mesh

    @torch.inference_mode()
    def volumes(self) -> Volumes | None:
        """Fuse, refine and filter both levels; None if nothing is near a surface."""
        seen = (self.coarse_store.seen > 0).view(self.grid.shape)
        psi = self._fuse("coarse", self.coarse_store, self.points, self.grid, seen)
        coarse, logits = self.network.refinement.coarse(psi[None], seen[None])
        near = seen
        if self.network.config.filter:
            near = seen & (torch.sigmoid(logits[0]) > self.settings.threshold)
        if not near.any():
            return None
        grid, box = _crop(self.grid, near)
        fine_grid = grid.refined(3)
        active = upsample(near[box], first_axis=0)
        points = fine_grid.centers().to(self.device)[active]
        store = self._store("fine", points)
        for frame in range(len(self.images)):
            self._select("fine", store, points, frame)
        visible = store.seen > 0
        active[active.clone()] = visible
        psi = self._fuse("fine", store, points, fine_grid, active, visible)
        inner = coarse[(slice(None), slice(None), *box)]
        fine, logits = self.network.refinement.fine(inner, psi[None], active[None])
        if self.network.config.filter:
            active = active & (torch.sigmoid(logits[0]) > self.settings.threshold)
        return Volumes(coarse[0], self.grid, fine[0], fine_grid, active)

    def _heads(self, level: str) -> int:
        """Heads of the selection logits; 0 if the strategy has no preference."""
        probe = torch.zeros(1, self.network.config.width, device=self.device)
        logits = self.network.selection_logits(level, probe)
        return 0 if logits is None else logits.shape[-1]

    def _store(self, level: str, points: Tensor) -> ViewStore:
        heads = self._heads(level) if self.policy.needs_logits else 0
        dtype = getattr(torch, self.settings.logits)
        store = ViewStore(self.settings.views, heads, self.policy, logits=dtype)
        store.grow(len(points))
        return store

    def _select(self, level: str, store: ViewStore, points: Tensor, frame: int) -> None:
        """Offer a frame to all voxels that it sees."""
        K, pose = self.K[frame], self.poses[frame]
        seen = self.network.visible(points, K[None], pose[None], self.size)
        voxels = seen[0].nonzero().squeeze(1)
        logits = None
        if self.policy.needs_logits:
            given = (self.maps[frame], points[voxels], K, pose, self.size)
            tokens = embed(self.network, level, *given)
            logits = self.network.selection_logits(level, tokens[0])
        keys = (points[voxels] / LATTICE).round().long()
        held = torch.stack(self.poses)[:, :3, 3][store.frames[voxels].long()]  # [M, K, 3]
        new = pose[:3, 3].expand(len(voxels), 1, 3)
        centers = torch.cat([held, new], 1) - points[voxels, None]
        store.add(frame, voxels, keys, logits, centers)

    def _fuse(
        self,
        level: str,
        store: ViewStore,
        points: Tensor,
        grid: VoxelGrid,
        where: Tensor,
        rows: Tensor | None = None,
    ) -> Tensor:
        """Fused features [D, X, Y, Z] at the voxels ``where``, zero elsewhere.

        ``rows`` [P] bool tells which of the store's voxels those are (None: as in ``where``).
        """
        volume = points.new_zeros(*grid.shape, self.network.config.width)
        index = (where.flatten() if rows is None else rows).nonzero().squeeze(1)
        fused = [self._fuse_batch(level, store, points, part) for part in self._batches(index)]
        volume[where] = torch.cat(fused)
        return volume.permute(3, 0, 1, 2)

    def _batches(self, index: Tensor) -> Iterator[Tensor]:
        yield from index.split(self.settings.batch)

    def _fuse_batch(self, level: str, store: ViewStore, points: Tensor, index: Tensor) -> Tensor:
        """Fused features [M, D] of the store's voxels ``index`` [M]."""
        frames = store.frames[index]
        channels = self.maps[0][level].shape[0]
        kept = Measurements(
            points.new_zeros(*frames.shape, channels),
            points.new_zeros(frames.shape),
            torch.zeros_like(frames, dtype=torch.bool),
            points.new_zeros(*frames.shape, 3),
            points.new_zeros(*frames.shape, CHANNELS if self.network.config.stereo else 0),
        )
        for frame in frames.unique().tolist():
            if frame < 0:
                continue
            row, slot = (frames == frame).nonzero(as_tuple=True)
            found = measured(
                self.network,
                level,
                self.maps[frame],
                points[index[row]],
                self.K[frame],
                self.poses[frame],
                self.size,
            )
            for every, part in zip(kept, found, strict=True):
                every[row, slot] = part[0]
        tokens = self.network.embed_kept(level, kept)
        fused, _ = self.network.fuse(level, tokens, frames >= 0, frames)
        return fused


def _crop(grid: VoxelGrid, near: Tensor) -> tuple[VoxelGrid, tuple[slice, slice, slice]]:
    """The part of a grid that holds all ``near`` voxels and what is beside them, and its slices."""
    index = near.nonzero()
    low = (index.amin(0) - 1).clamp(min=0).tolist()
    high = torch.minimum(index.amax(0) + 2, torch.tensor(near.shape)).tolist()
    x, y, z = (slice(a, b) for a, b in zip(low, high, strict=True))
    return grid.block(low, high), (x, y, z)


def extract(
    decode: Decode, grid: VoxelGrid, active: Tensor, resolution: float, batch: int = 1 << 18
) -> trimesh.Trimesh:
    """Mesh the occupancy inside active voxels, and only there.

    A marching-cubes cell gives surface only if all its 8 corners lie in active voxels, so the
    boundary of the mask never makes a surface.

    Args:
        decode: occupancy logits [P] at points [P, 3] (> 0: solid).
        grid: the fine voxels.
        active: bool [X, Y, Z].
        resolution: edge of the marching-cubes cells, metres; must divide the voxel.
        batch: points decoded at a time.
    """
    n = cells_per_voxel(grid.voxel, resolution)
    fine = grid.refined(n)
    mask = active
    for axis in range(3):
        mask = mask.repeat_interleave(n, dim=axis)
    if not mask.any():
        return trimesh.Trimesh()
    index = mask.flatten().nonzero().squeeze(1)
    values = torch.full((mask.numel(),), -1.0)
    step = torch.tensor([fine.shape[1] * fine.shape[2], fine.shape[2], 1])
    origin, shape = torch.tensor(fine.origin), torch.tensor(fine.shape)
    for part in index.split(batch):
        ijk = (part[:, None] // step) % shape
        values[part] = decode(origin + (ijk + 0.5) * fine.voxel).float().cpu()
    return mesh_of(values.view(mask.shape), mask.cpu(), fine)


def crossing_voxels(decode: Decode, grid: VoxelGrid, active: Tensor) -> Tensor:
    """Active voxels within one voxel of a change of occupancy between voxel centres: bool.

    Where no mask tells where the surface is (``filter=false``) this finds the region worth
    decoding finely, after the multi-resolution extraction of Occupancy Networks (2019).
    """
    centers = grid.centers()[active]
    solid = torch.zeros(grid.shape)
    solid[active] = torch.cat([(decode(p) > 0).float().cpu() for p in centers.split(1 << 18)])
    low, high = torch.where(active, solid, 1.0), torch.where(active, solid, 0.0)
    most = F.max_pool3d(high[None, None], 3, 1, 1)[0, 0]
    least = -F.max_pool3d(-low[None, None], 3, 1, 1)[0, 0]
    return active & (most > least)
