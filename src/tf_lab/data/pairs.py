"""Pairs of frames with known pixel correspondences, for pre-training the encoder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset

from tf_lab.data.batch import Batch
from tf_lab.data.capture import Capture
from tf_lab.data.photometric import photometric
from tf_lab.data.scene import Scene, cached_scene
from tf_lab.data.settings import PhotometricSettings
from tf_lab.data.steps import own_steps
from tf_lab.data.tsdf import unproject
from tf_lab.errors import TFLabError
from tf_lab.geometry import in_view, invert_pose, project, transform

NEAR, FAR = 0.3, 5.0  # metres


@dataclass
class PairBatch(Batch):
    """Corresponding pixels of P points in pairs of images.

    Attributes:
        images: uint8 [B, 2, 3, H, W].
        uv_a: [B, P, 2] pixels in the first image.
        uv_b: [B, P, 1 + E, 2] pixels in the second: the true one, then E wrong ones along the
            epipolar line (the same ray at other depths).
    """

    images: Tensor
    uv_a: Tensor
    uv_b: Tensor


@dataclass(frozen=True)
class PairSettings:
    """How pairs are drawn.

    Attributes:
        pairs: a step.
        points: correspondences a pair.
        epipolar: wrong candidates along each epipolar line.
        baseline: least distance of the cameras, metres.
        overlap: least share of the first image's points that the second sees.
        jitter: deviation of the true pixel from its place, pixels: poses and depth of real captures
            are never exact.
    """

    pairs: int = 8
    points: int = 320
    epipolar: int = 8
    baseline: float = 0.15
    overlap: float = 0.3
    jitter: float = 0.0


class PairStream(IterableDataset[PairBatch]):
    """An endless stream of batches, each a function of (seed, step) alone.

    Args:
        scenes: prepared ones, or captures with depth.
        settings: how pairs are drawn.
        seed: of all draws.
        first_step: where the stream begins.
        augment: photometric effects, drawn for every image by itself; None: images as they are.

    Raises:
        TFLabError: there is no scene, or one has no depth.
    """

    def __init__(
        self,
        scenes: Sequence[Path | Capture],
        settings: PairSettings,
        seed: int,
        first_step: int = 0,
        augment: PhotometricSettings | None = None,
    ) -> None:
        if not scenes:
            raise TFLabError("there is no scene to pre-train on; prepare the data first")
        self.scenes, self.settings, self.augment = list(scenes), settings, augment
        self.seed, self.first_step = seed, first_step

    def __iter__(self) -> Iterator[PairBatch]:
        for step in own_steps(self.first_step):
            yield self.batch(np.random.default_rng([self.seed, step]))

    def batch(self, rng: np.random.Generator) -> PairBatch:
        """One batch.

        Raises:
            TFLabError: no pair overlaps in 100 draws a pair.
        """
        found: list[PairBatch] = []
        for _ in range(100 * self.settings.pairs):
            chosen = self.scenes[rng.integers(len(self.scenes))]
            pair = self.pair(cached_scene(chosen) if isinstance(chosen, Path) else chosen, rng)
            if pair is not None:
                found.append(pair)
            if len(found) == self.settings.pairs:
                return PairBatch(
                    **{k: torch.stack([vars(p)[k] for p in found]) for k in vars(found[0])}
                )
        raise TFLabError("the frames of the scenes do not overlap enough for pre-training")

    def pair(self, scene: Capture, rng: np.random.Generator) -> PairBatch | None:
        """One pair, without the batch axis; None if the frame drawn has no partner."""
        s = self.settings
        a = int(rng.integers(len(scene.frames)))
        points, uv_a = self._points(scene, a, rng)
        b = self._partner(scene, a, points[:200], rng)
        if b is None:
            return None
        K, cam_T_world = torch.from_numpy(scene.K[b]).float(), _pose(scene, b, inverse=True)
        uv, z = project(points, K, cam_T_world)
        depth_b = scene.depth(b)
        assert depth_b is not None  # frame a had depth, so the scene has
        seen = in_view(uv, z, scene.size, NEAR, FAR).nonzero().squeeze(1)
        u, v = uv[seen].round().long().unbind(-1)
        reading = torch.from_numpy(depth_b)[v, u]
        seen = seen[(reading - z[seen]).abs() < 0.03 + 0.02 * z[seen]]
        if len(seen) < s.points:
            return None
        seen = seen[: s.points]
        images = [scene.image(a), scene.image(b)]
        if self.augment is not None:
            images = [photometric(image, self.augment, rng) for image in images]
        true = uv[seen] + s.jitter * torch.from_numpy(rng.standard_normal((len(seen), 2))).float()
        return PairBatch(
            images=torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).contiguous(),
            uv_a=uv_a[seen],
            uv_b=torch.cat([true[:, None], self._epipolar(scene, a, b, points[seen], rng)], dim=1),
        )

    def _points(self, scene: Capture, a: int, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Random pixels of frame a with depth: world points [M, 3] and pixels [M, 2]."""
        depth = scene.depth(a)
        if depth is None:
            where = scene.directory if isinstance(scene, Scene) else scene.name
            raise TFLabError(f"{where}: pre-training needs depth, this scene has none")
        sparse = np.where(rng.random(depth.shape) < 0.15, depth, 0)
        rows, columns = np.nonzero(sparse)
        points = unproject(
            torch.from_numpy(sparse), torch.from_numpy(scene.K[a]).float(), _pose(scene, a)
        )
        order = torch.from_numpy(rng.permutation(len(points)))
        pixels = torch.from_numpy(np.stack([columns, rows], -1)).float()
        return points[order], pixels[order]

    def _partner(
        self, scene: Capture, a: int, points: Tensor, rng: np.random.Generator
    ) -> int | None:
        """A random frame that overlaps frame a from another place."""
        poses = torch.from_numpy(scene.world_T_cam).float()
        uv, z = project(points, torch.from_numpy(scene.K).float(), invert_pose(poses))
        share = in_view(uv, z, scene.size, NEAR, FAR).float().mean(-1)
        distance = (poses[:, :3, 3] - poses[a, :3, 3]).norm(dim=-1)
        good = (share >= self.settings.overlap) & (distance >= self.settings.baseline)
        candidates = good.nonzero().squeeze(1)
        return int(candidates[rng.integers(len(candidates))]) if len(candidates) else None

    def _epipolar(
        self, scene: Capture, a: int, b: int, points: Tensor, rng: np.random.Generator
    ) -> Tensor:
        """Pixels [P, E, 2] in frame b of wrong depths along the rays from frame a."""
        camera = transform(_pose(scene, a, inverse=True), points)
        n = (len(points), self.settings.epipolar, 1)
        factor = np.exp(rng.choice([-1, 1], n) * rng.uniform(0.08, 0.9, n)).astype(np.float32)
        wrong = (camera[:, None] * torch.from_numpy(factor)).reshape(-1, 3)
        K = torch.from_numpy(scene.K[b]).float()
        uv, _ = project(transform(_pose(scene, a), wrong), K, _pose(scene, b, inverse=True))
        return uv.view(n[0], n[1], 2)


def _pose(scene: Capture, index: int, inverse: bool = False) -> Tensor:
    pose = torch.from_numpy(scene.world_T_cam[index]).float()
    return invert_pose(pose) if inverse else pose
