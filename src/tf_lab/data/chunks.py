"""Training chunks: 1.5 m of a scene, the images that see it, and what is true in it.

A `ChunkRecord` is a chunk as it is drawn from a scene, or stored in a shard; `make_batch` makes of
records what a training step sees, wherever they come from.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Protocol

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset

from tf_lab.data.batch import Batch
from tf_lab.data.camera_noise import disturb_cameras, share_of
from tf_lab.data.jpeg import decode_jpeg
from tf_lab.data.readers.images import natural_order
from tf_lab.data.settings import CameraNoise, ChunkSettings
from tf_lab.errors import TFLabError
from tf_lab.geometry import COARSE, FINE, VoxelGrid

FINE_GRID = VoxelGrid((0.0, 0.0, 0.0), FINE, (15, 15, 15))
# one voxel of margin, so that the refinement of the chunk's border sees what lies beyond it
COARSE_GRID = VoxelGrid((-COARSE, -COARSE, -COARSE), COARSE, (7, 7, 7))


@dataclass(frozen=True)
class ChunkRecord:
    """A chunk before the choices of a step, in its own frame (its lower corner is the origin).

    Attributes:
        scene: which it is of: a directory, or only its name.
        frames: names of the images, V or more.
        size: (width, height) of the images.
        images: JPEG files, byte by byte as the scene stores them.
        K, world_T_cam, coarse_target, fine_target, points, sdf, stereo: as in `ChunkBatch`, without
            B.
    """

    scene: str
    frames: Sequence[str]
    size: tuple[int, int]
    images: Sequence[bytes]
    K: Tensor
    world_T_cam: Tensor
    coarse_target: Tensor
    fine_target: Tensor
    points: Tensor
    sdf: Tensor
    stereo: Tensor | None = None

    def decode(self, chosen: Sequence[int], images: np.ndarray) -> None:
        """Decode some of the images into an array, uint8 [V, 3, H, W].

        Raises:
            TFLabError: one is damaged.
        """
        for i, image in zip(chosen, images, strict=True):
            try:
                decode_jpeg(self.images[i], image)
            except ValueError as error:
                raise TFLabError(
                    f"{self.scene}/color/{self.frames[i]}.jpg: damaged ({error}); delete the scene "
                    "and prepare it again"
                ) from error


@dataclass
class ChunkBatch(Batch):
    """A batch of chunks, each in its own frame (its lower corner is the origin).

    Attributes:
        images: uint8 [B, V, 3, H, W].
        K: [B, V, 3, 3].
        world_T_cam: [B, V, 4, 4], camera to chunk.
        times: int64 [B, V], numbers that grow with the images' time, as their names tell it.
        coarse_target: bool [B, 7, 7, 7], surface within 30 cm of the voxel centre.
        fine_target: bool [B, 15, 15, 15], surface within 10 cm.
        points: [B, P, 3], metres.
        sdf: [B, P] signed distance in metres, NaN where unknown.
        draws: int64 [B], of each chunk what makes its random choices its own.
        keep: K_t, views a voxel keeps; 0: all images, valid or not.
        rule: the policy of view selection that chooses them.
        scenes: B names, of which the chunks are.
        stereo: float16 [B, V, 2, h, w], the images' depth maps (`tf_lab.stereo.depth`), if wanted.
    """

    images: Tensor
    K: Tensor
    world_T_cam: Tensor
    times: Tensor
    coarse_target: Tensor
    fine_target: Tensor
    points: Tensor
    sdf: Tensor
    draws: Tensor
    keep: int
    rule: str
    scenes: Sequence[str] = ()
    stereo: Tensor | None = None


class ChunkSource(Protocol):
    """Where training chunks come from: scenes (`ChunkSampler`) or shards (`ShardSource`)."""

    def stream(
        self, seed: int, first_step: int, rank: int, world: int
    ) -> IterableDataset[ChunkBatch]:
        """An endless stream of the batches of one process, from a step on.

        Args:
            seed: of the run.
            first_step: where to start.
            rank: of this process in distributed training.
            world: how many processes there are.
        """
        ...


def make_batch(
    records: Sequence[ChunkRecord], settings: ChunkSettings, seed: int, rank: int, step: int
) -> ChunkBatch:
    """The batch of one process at a step, with what is chosen anew at every step.

    How many views are kept and by which rule is a function of seed and step, the same in all
    processes: none waits for another that keeps more. What its random choices are is a function of
    seed, step and the chunk, whichever process has it. Which images are used, of records that hold
    more than ``settings.images``, and how wrong their cameras are made, are functions of seed, rank
    and step.

    Raises:
        TFLabError: an image is damaged, or they are of several sizes.
    """
    sizes = sorted({r.size for r in records})
    if len(sizes) > 1:
        raise TFLabError(f"images of {sizes} pixels in one batch; prepare all scenes at one size")
    rng = np.random.default_rng([seed, 0, step, 1])  # [seed, 0, index] is a record's
    keep = int(rng.choice(settings.views)) if settings.views else 0
    rule = _draw(settings.rules, rng)
    rng = np.random.default_rng([seed, rank, step, 2])
    chosen = [_choose(len(r.images), settings.images, rng) for r in records]
    views = list(zip(records, chosen, strict=True))
    width, height = sizes[0]
    images = np.empty((len(records), len(chosen[0]), 3, height, width), np.uint8)
    for (record, view), row in zip(views, images, strict=True):
        record.decode(view, row)
    cameras = [(r.K[v], r.world_T_cam[v]) for r, v in views]
    if settings.camera_noise != CameraNoise():
        rng = np.random.default_rng([seed, rank, step, 4])
        cameras = [_disturbed(*given, settings.camera_noise, rng) for given in cameras]
    return ChunkBatch(
        images=torch.from_numpy(images),
        K=torch.stack([K for K, _ in cameras]),
        world_T_cam=torch.stack([pose for _, pose in cameras]),
        times=torch.stack([_times([r.frames[i] for i in v]) for r, v in views]),
        coarse_target=torch.stack([r.coarse_target for r in records]),
        fine_target=torch.stack([r.fine_target for r in records]),
        points=torch.stack([r.points for r in records]),
        sdf=torch.stack([r.sdf for r in records]),
        draws=torch.tensor([_chance(r, seed, step) for r in records]),
        keep=keep,
        rule=rule,
        scenes=[PurePosixPath(r.scene).name for r in records],
        stereo=_stacked([None if r.stereo is None else r.stereo[v] for r, v in views]),
    )


def _disturbed(
    K: Tensor, world_T_cam: Tensor, noise: CameraNoise, rng: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """The cameras of a chunk, by a share of the noise, uniform in 0..1: some are nearly right."""
    noise = share_of(noise, rng.uniform())
    wrong = disturb_cameras(K.numpy(), world_T_cam.numpy(), noise, rng)
    return torch.from_numpy(wrong[0]), torch.from_numpy(wrong[1])


def _stacked(parts: Sequence[Tensor | None]) -> Tensor | None:
    """All of them, if all are there."""
    there = [part for part in parts if part is not None]
    return torch.stack(there) if len(there) == len(parts) else None


def _times(names: Sequence[str]) -> Tensor:
    """The place of each frame [V] in the natural order of their names, which is that of time."""
    keys = [natural_order(PurePosixPath(name)) for name in names]
    order = sorted(range(len(names)), key=keys.__getitem__)
    return torch.tensor(order).argsort()


def _chance(record: ChunkRecord, seed: int, step: int) -> int:
    """A number by which the random choices of a step differ from chunk to chunk."""
    chunk = zlib.crc32(record.points.numpy().tobytes())
    return int(np.random.default_rng([seed, step, chunk, 3]).integers(2**62))


def _draw(weights: Mapping[str, float], rng: np.random.Generator) -> str:
    """A name at random, by weights."""
    names = sorted(weights)
    shares = np.array([weights[name] for name in names], float)
    return names[rng.choice(len(names), p=shares / shares.sum())]


def _choose(count: int, wanted: int, rng: np.random.Generator) -> list[int]:
    """``wanted`` of ``count`` at random; all of them, in their order, if there are no more."""
    if count <= wanted:
        return list(range(count))
    return [int(i) for i in rng.choice(count, wanted, replace=False)]
