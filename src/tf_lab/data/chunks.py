"""Training chunks: 1.5 m of a scene, the images that see it, and what is true in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from tf_lab.data.groundtruth import GroundTruth
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.geometry import (
    CHUNK,
    COARSE,
    FINE,
    VoxelGrid,
    in_view,
    invert_pose,
    project,
    rotation_about_z,
)

FINE_GRID = VoxelGrid((0.0, 0.0, 0.0), FINE, (15, 15, 15))
# one voxel of margin, so that the refinement of the chunk's border sees what lies beyond it
COARSE_GRID = VoxelGrid((-COARSE, -COARSE, -COARSE), COARSE, (7, 7, 7))
TRUNCATION = 0.10  # metres; near-surface samples lie within it


@dataclass
class ChunkBatch:
    """A batch of chunks, each in its own frame (its lower corner is the origin).

    Attributes:
        images: uint8 [B, V, 3, H, W].
        K: [B, V, 3, 3].
        world_T_cam: [B, V, 4, 4], camera to chunk.
        coarse_target: bool [B, 7, 7, 7], surface within 30 cm of the voxel centre.
        fine_target: bool [B, 15, 15, 15], surface within 10 cm.
        points: [B, P, 3], metres.
        sdf: [B, P] signed distance in metres, NaN where unknown.
        keep: int [B], K_t, the same for all: views a voxel keeps; 0: all images, valid or not.
        ranked: bool [B], the same for all: it keeps those of the highest attention weight.
    """

    images: Tensor
    K: Tensor
    world_T_cam: Tensor
    coarse_target: Tensor
    fine_target: Tensor
    points: Tensor
    sdf: Tensor
    keep: Tensor
    ranked: Tensor

    def to(self, device: torch.device, non_blocking: bool = False) -> ChunkBatch:
        """The batch on another device (Lightning calls this)."""
        moved = {k: v.to(device, non_blocking=non_blocking) for k, v in vars(self).items()}
        return ChunkBatch(**moved)


@dataclass(frozen=True)
class ChunkSettings:
    """How chunks are drawn.

    Attributes:
        chunks: chunks a step (4 in the paper).
        images: random images a chunk (8 in the paper).
        views: K_t, how many of its valid images every voxel keeps, as at test time; one of the
            numbers is drawn a step. Empty: it keeps all images, valid or not (paper).
        ranked: share of the steps that keep the views of the highest attention weight, as
            attention selection does at test time, instead of random ones.
        points: occupancy samples a chunk (1000 in the paper).
        near_share: share of them within 10 cm of the surface (0.8 in the paper).
        coverage: least share of the chunk that an image must see.
        augment: rotate the chunk about the vertical by a random angle.
    """

    chunks: int = 4
    images: int = 8
    views: tuple[int, ...] = ()
    ranked: float = 0.0
    points: int = 1000
    near_share: float = 0.8
    coverage: float = 0.3
    augment: bool = True


class ChunkSampler:
    """Draws chunks of scenes.

    Args:
        scenes: scene directories with ground truth.
        settings: how to draw.
        near, far: valid depth range, metres.
    """

    def __init__(
        self, scenes: Sequence[Path], settings: ChunkSettings, near: float, far: float
    ) -> None:
        if not scenes:
            raise TFLabError("there is no training scene; prepare the data first")
        self.scenes, self.settings = list(scenes), settings
        self.near, self.far = near, far

    def batch(self, rng: np.random.Generator) -> ChunkBatch:
        """One batch, a function of the generator's state alone."""
        s = self.settings
        keep = int(rng.choice(s.views)) if s.views else 0
        ranked = bool(rng.random() < s.ranked)
        chunks: list[ChunkBatch] = []
        for _ in range(100 * self.settings.chunks):
            directory = self.scenes[rng.integers(len(self.scenes))]
            chunk = self.chunk(*_open(directory), rng, keep, ranked)
            if chunk is not None:
                chunks.append(chunk)
            if len(chunks) == self.settings.chunks:
                return ChunkBatch(
                    **{k: torch.stack([vars(c)[k] for c in chunks]) for k in vars(chunks[0])}
                )
        raise TFLabError(
            f"no chunk with {s.images} images among 100 draws; use fewer (training.images) or "
            "less training.coverage"
        )

    def chunk(
        self,
        scene: Scene,
        truth: GroundTruth,
        rng: np.random.Generator,
        keep: int = 0,
        ranked: bool = False,
    ) -> ChunkBatch | None:
        """One random chunk, without the batch axis; None if too few images see it."""
        s = self.settings
        chunk_T_world = self._place(truth, rng)
        poses = chunk_T_world @ torch.from_numpy(scene.world_T_cam)
        chosen = self._choose_views(scene, poses.float(), rng)
        if chosen is None:
            return None
        world_T_chunk = invert_pose(chunk_T_world).float()

        def to_world(points: Tensor) -> Tensor:
            return points.reshape(-1, 3) @ world_T_chunk[:3, :3].T + world_T_chunk[:3, 3]

        coarse = truth.surface_distance(to_world(COARSE_GRID.centers())).view(COARSE_GRID.shape)
        fine = truth.surface_distance(to_world(FINE_GRID.centers())).view(FINE_GRID.shape)
        candidates = torch.from_numpy(rng.random((8 * s.points, 3), np.float32)) * CHUNK
        near = truth.surface_distance(to_world(candidates)) < TRUNCATION
        n_near = min(round(s.near_share * s.points), int(near.sum()))
        uniform = candidates[len(candidates) - (s.points - n_near) :]
        points = torch.cat([candidates[near][:n_near], uniform])
        images = np.stack([scene.image(i) for i in chosen])
        return ChunkBatch(
            images=torch.from_numpy(images).permute(0, 3, 1, 2).contiguous(),
            K=torch.from_numpy(scene.K[chosen]).float(),
            world_T_cam=poses[chosen].float(),
            coarse_target=coarse < COARSE,
            fine_target=fine < FINE,
            points=points,
            sdf=truth.signed_distance(to_world(points)),
            keep=torch.tensor(keep),
            ranked=torch.tensor(ranked),
        )

    def _place(self, truth: GroundTruth, rng: np.random.Generator) -> Tensor:
        """chunk_T_world [4, 4], float64, of a random chunk: weighted, jittered, rotated."""
        probability = truth.weight / truth.weight.sum()
        center = truth.centers[rng.choice(len(probability), p=probability)].astype(np.float64)
        center += rng.uniform(-COARSE / 2, COARSE / 2, 3)
        chunk_T_world = torch.eye(4, dtype=torch.float64)
        angle = rng.uniform(0, 2 * np.pi) if self.settings.augment else 0.0
        chunk_T_world[:3, :3] = rotation_about_z(angle)
        chunk_T_world[:3, 3] = CHUNK / 2 - chunk_T_world[:3, :3] @ torch.from_numpy(center)
        return chunk_T_world

    def _choose_views(
        self, scene: Scene, chunk_T_cam: Tensor, rng: np.random.Generator
    ) -> np.ndarray | None:
        """Random frames that see enough of the chunk; None if there are fewer than wanted."""
        probes = VoxelGrid((0.0, 0.0, 0.0), COARSE, (5, 5, 5)).centers().reshape(-1, 3)
        uv, depth = project(probes, torch.from_numpy(scene.K).float(), invert_pose(chunk_T_cam))
        share = in_view(uv, depth, scene.size, self.near, self.far).float().mean(-1).numpy()
        candidates = np.flatnonzero(share >= self.settings.coverage)
        if len(candidates) < self.settings.images:
            return None
        return rng.choice(candidates, self.settings.images, replace=False)


@lru_cache(maxsize=256)
def _open(directory: Path) -> tuple[Scene, GroundTruth]:
    scene = Scene(directory)
    return scene, GroundTruth(scene.groundtruth)


class ChunkStream(IterableDataset[ChunkBatch]):
    """An endless stream of batches, each a function of (seed, rank, step) alone.

    So training can start again at any step and meet the same batches, whatever the number of
    worker processes.

    Args:
        sampler: draws the chunks.
        seed: of the run.
        first_step: where to start.
        rank: of this process in distributed training.
    """

    def __init__(self, sampler: ChunkSampler, seed: int, first_step: int = 0, rank: int = 0):
        self.sampler, self.seed = sampler, seed
        self.first_step, self.rank = first_step, rank

    def __iter__(self) -> Iterator[ChunkBatch]:
        worker = get_worker_info()
        offset, stride = (worker.id, worker.num_workers) if worker else (0, 1)
        step = self.first_step + offset
        while True:
            yield self.sampler.batch(np.random.default_rng([self.seed, self.rank, step]))
            step += stride
