"""Training chunks drawn from scenes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset

from tf_lab.data.chunks import COARSE_GRID, FINE_GRID, ChunkBatch, ChunkRecord, make_batch
from tf_lab.data.groundtruth import GroundTruth
from tf_lab.data.scene import Scene
from tf_lab.data.settings import CameraNoise, ChunkSettings
from tf_lab.data.steps import own_steps
from tf_lab.data.stereo_maps import read_stereo
from tf_lab.errors import TFLabError
from tf_lab.geometry import (
    CHUNK,
    COARSE,
    FINE,
    VoxelGrid,
    frustum_sides,
    in_view,
    invert_pose,
    project,
    rotation_about_z,
    transform,
)

TRUNCATION = 0.10  # metres; near-surface samples lie within it
ATTEMPTS = 100  # placements of a chunk before giving up
MOST_OPEN = 256  # scenes
_PROBES = VoxelGrid((0.0, 0.0, 0.0), COARSE, (5, 5, 5)).centers().reshape(-1, 3)
_RADIUS = float((_PROBES - CHUNK / 2).norm(dim=-1).max())
_VOXELS = torch.cat([grid.centers().reshape(-1, 3) for grid in (COARSE_GRID, FINE_GRID)])


class ChunkScene:
    """A scene opened for drawing chunks, with what all of them need computed once.

    Args:
        directory: of a scene with ground truth.
    """

    def __init__(self, directory: Path) -> None:
        self.scene = Scene(directory)
        self.truth = GroundTruth(self.scene.groundtruth)
        self._stereo: dict[CameraNoise, np.ndarray] = {}
        self.K = torch.from_numpy(self.scene.K).float()
        self.world_T_cam = torch.from_numpy(self.scene.world_T_cam)
        self.cam_T_world = invert_pose(self.world_T_cam)
        self.sides = frustum_sides(self.K, self.scene.size)
        weight = np.cumsum(self.truth.weight, dtype=np.float64)
        self.cumulative_weight = weight / weight[-1]

    def place(self, rng: np.random.Generator, turn: bool) -> Tensor:
        """chunk_T_world [4, 4], float64, of a random chunk: weighted, jittered and turned."""
        index = np.searchsorted(self.cumulative_weight, rng.random(), side="right")
        center = self.truth.centers[index].astype(np.float64)
        center += rng.uniform(-COARSE / 2, COARSE / 2, 3)
        chunk_T_world = torch.eye(4, dtype=torch.float64)
        angle = rng.uniform(0, 2 * np.pi) if turn else 0.0
        chunk_T_world[:3, :3] = rotation_about_z(angle)
        chunk_T_world[:3, 3] = CHUNK / 2 - chunk_T_world[:3, :3] @ torch.from_numpy(center)
        return chunk_T_world

    def stereo(self, noise: CameraNoise, frames: np.ndarray) -> Tensor:
        """Depth maps float16 [V, 2, h, w] of frames [V]. Raises TFLabError: there are none."""
        if noise not in self._stereo:
            self._stereo[noise] = read_stereo(self.scene, noise)
        return torch.from_numpy(self._stereo[noise][frames])

    def coverage(self, world_T_chunk: Tensor, near: float, far: float) -> np.ndarray:
        """The share [N] of a chunk that each frame sees, between two depths in metres."""
        cam_T_chunk = (self.cam_T_world @ world_T_chunk).float()
        # most frames look elsewhere: none of the chunk's bounding sphere is in their frustum
        center = cam_T_chunk[:, :3, :3].sum(2) * (CHUNK / 2) + cam_T_chunk[:, :3, 3]
        inside = (self.sides @ center[..., None]).squeeze(-1).amin(1)
        depth = center[:, 2]
        close = (inside > -_RADIUS) & (depth > near - _RADIUS) & (depth < far + _RADIUS)
        uv, depth = project(_PROBES, self.K[close], cam_T_chunk[close])
        share = np.zeros(len(close), np.float32)
        share[close.numpy()] = in_view(uv, depth, self.scene.size, near, far).float().mean(-1)
        return share


def choose_frames(
    share: np.ndarray, settings: ChunkSettings, rng: np.random.Generator
) -> np.ndarray | None:
    """Random frames of those that see enough of a chunk, filled up with those that see most.

    Args:
        share: [N], of the chunk that each frame sees.
        settings: how many frames, and what is enough.
        rng: of the choice.

    Returns:
        Frames [images], in random order; None if fewer than ``seen_by`` see enough.
    """
    s = settings
    enough = np.flatnonzero(share >= s.coverage)
    if len(enough) < min(s.seen_by, s.images) or len(share) < s.images:
        return None
    if len(enough) >= s.images:
        return rng.choice(enough, s.images, replace=False)
    rest = rng.permutation(np.flatnonzero(share < s.coverage))
    rest = rest[np.argsort(-share[rest], kind="stable")]
    return rng.permutation(np.concatenate([enough, rest[: s.images - len(enough)]]))


class ChunkSampler:
    """Draws chunks of scenes.

    Args:
        scenes: scene directories with ground truth.
        settings: how to draw.
        near, far: valid depth range, metres.
        stereo: whether the images' depth maps are wanted, which `write_stereo` has written.
    """

    def __init__(
        self,
        scenes: Sequence[Path],
        settings: ChunkSettings,
        near: float,
        far: float,
        stereo: bool = False,
    ) -> None:
        if not scenes:
            raise TFLabError(
                "no training scene: give data.size=, or more captures than val and test hold"
            )
        self.scenes, self.settings = list(scenes), settings
        self.near, self.far, self.stereo = near, far, stereo

    def stream(self, seed: int, first_step: int, rank: int, world: int) -> ChunkStream:
        """See `ChunkSource`."""
        return ChunkStream(self, seed, first_step, rank, world)

    def record(self, seed: int, index: int) -> ChunkRecord:
        """A chunk of a random scene, a function of seed and index alone.

        Raises:
            TFLabError: a scene is damaged, or no chunk is seen by enough images.
        """
        rng = np.random.default_rng([seed, 0, index])  # with a fourth number: a step's
        for _ in range(ATTEMPTS):
            record = self.draw(_open(self.scenes[rng.integers(len(self.scenes))]), rng)
            if record is not None:
                return record
        raise TFLabError(
            f"no chunk with {self.settings.images} images among {ATTEMPTS} draws; use fewer "
            "(training.images, training.seen_by) or less training.coverage"
        )

    def draw(self, opened: ChunkScene, rng: np.random.Generator) -> ChunkRecord | None:
        """One random chunk of a scene; None if too few images see it."""
        s, scene, truth = self.settings, opened.scene, opened.truth
        chunk_T_world = opened.place(rng, s.augment)
        world_T_chunk = invert_pose(chunk_T_world)
        share = opened.coverage(world_T_chunk, self.near, self.far)
        chosen = choose_frames(share, s, rng)
        if chosen is None:
            return None
        candidates = torch.from_numpy(rng.random((8 * s.points, 3), np.float32)) * CHUNK
        to_world = world_T_chunk.float()
        distance = truth.surface_distance(transform(to_world, torch.cat([_VOXELS, candidates])))
        n_coarse, n_fine = (math.prod(grid.shape) for grid in (COARSE_GRID, FINE_GRID))
        coarse, fine, surface = distance.split([n_coarse, n_fine, len(candidates)])
        near = torch.nonzero(surface < TRUNCATION).squeeze(1)
        n_near = min(round(s.near_share * s.points), len(near))
        uniform = candidates[len(candidates) - (s.points - n_near) :]
        points = torch.cat([candidates[near[:n_near]], uniform])
        return ChunkRecord(
            scene=str(scene.directory),
            frames=[scene.frames[i] for i in chosen],
            size=scene.size,
            images=[scene.jpeg(i) for i in chosen],
            K=opened.K[chosen],
            world_T_cam=(chunk_T_world @ opened.world_T_cam[chosen]).float(),
            coarse_target=coarse.view(COARSE_GRID.shape) < COARSE,
            fine_target=fine.view(FINE_GRID.shape) < FINE,
            points=points,
            sdf=truth.signed_distance(transform(to_world, points)),
            stereo=opened.stereo(s.camera_noise, chosen) if self.stereo else None,
        )


def _most_open() -> int:
    """Scenes that a process keeps open: with 3 files each, well below what the system allows."""
    try:
        import resource
    except ImportError:  # Windows
        return MOST_OPEN
    allowed, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST_OPEN if allowed == resource.RLIM_INFINITY else min(MOST_OPEN, max(1, allowed // 8))


_open = lru_cache(maxsize=_most_open())(ChunkScene)


class ChunkStream(IterableDataset[ChunkBatch]):
    """An endless stream of batches, each a function of (seed, step, rank, world) alone.

    So training can start again at any step and meet the same batches, whatever the number of
    worker processes. The chunks of a step depend on how many there are in all, not on how many
    processes share them: two processes with 2 chunks each train on what one with 4 does.

    Args:
        sampler: draws the chunks.
        seed: of the run.
        first_step: where to start.
        rank: of this process in distributed training.
        world: how many processes there are.
    """

    def __init__(
        self, sampler: ChunkSampler, seed: int, first_step: int = 0, rank: int = 0, world: int = 1
    ) -> None:
        self.sampler, self.seed = sampler, seed
        self.first_step, self.rank, self.world = first_step, rank, world

    def __iter__(self) -> Iterator[ChunkBatch]:
        return map(self.batch, own_steps(self.first_step))

    def batch(self, step: int) -> ChunkBatch:
        """This process's part of the batch of a step."""
        settings = self.sampler.settings
        first = (step * self.world + self.rank) * settings.chunks
        records = [
            self.sampler.record(self.seed, index) for index in range(first, first + settings.chunks)
        ]
        return make_batch(records, settings, self.seed, self.rank, step)
