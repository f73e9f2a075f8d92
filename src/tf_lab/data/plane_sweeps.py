"""Plane sweeps of frames whose depth is known, to train what reads depth from their scores."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset

from tf_lab.data.batch import Batch
from tf_lab.data.camera_noise import disturb_cameras, share_of
from tf_lab.data.capture import Capture
from tf_lab.data.photometric import photometric
from tf_lab.data.resize import Resized
from tf_lab.data.scene import cached_scene
from tf_lab.data.settings import CameraNoise, PhotometricSettings
from tf_lab.data.steps import own_steps
from tf_lab.errors import TFLabError
from tf_lab.stereo.depth import StereoSettings, scores_of, small_view
from tf_lab.stereo.sources import choose_sources

LATER = 0.5  # share of training frames that later frames may be sources of, too
MISSED = 0.2  # share of the other frames that are not there, so that sources differ
TRIES = 100  # draws a frame


@dataclass
class SweepBatch(Batch):
    """Frames: scores float32 [B, P, h, w] of their planes, depth float32 [B, h, w] (0: unknown)."""

    scores: Tensor
    depth: Tensor


@dataclass(frozen=True)
class SweepDraws:
    """How frames are drawn.

    Attributes:
        frames: a step.
        noise: how wrong cameras are at most: every frame by a share of it.
        augment: photometric effects, drawn for every image by itself.
    """

    frames: int
    noise: CameraNoise
    augment: PhotometricSettings


class SweepStream(IterableDataset[SweepBatch]):
    """An endless stream of batches, each a function of (seed, step) alone.

    Args:
        scenes: prepared ones, with depth.
        settings: of the sweeps.
        draws: how frames are drawn.
        seed: of all draws.
        first_step: where the stream begins.
    """

    def __init__(
        self,
        scenes: Sequence[Path],
        settings: StereoSettings,
        draws: SweepDraws,
        seed: int,
        first_step: int = 0,
    ) -> None:
        if not scenes:
            raise TFLabError("there is no scene to pre-train on; prepare the data first")
        self.scenes, self.settings, self.draws = list(scenes), settings, draws
        self.seed, self.first_step = seed, first_step

    def __iter__(self) -> Iterator[SweepBatch]:
        for step in own_steps(self.first_step):
            yield self.batch(np.random.default_rng([self.seed, step]))

    def batch(self, rng: np.random.Generator) -> SweepBatch:
        """One batch.

        Raises:
            TFLabError: hardly a frame has depth, and others to be compared with.
        """
        found: list[SweepBatch] = []
        for _ in range(TRIES * self.draws.frames):
            scene = cached_scene(self.scenes[rng.integers(len(self.scenes))])
            one = self._drawn(scene, rng)
            found += [one] if one is not None else []
            if len(found) == self.draws.frames:
                return joined(found)
        raise TFLabError("hardly a frame of the scenes has depth and others that overlap it")

    def _drawn(self, scene: Capture, rng: np.random.Generator) -> SweepBatch | None:
        """A random frame, without the batch axis; None if it has no sources or no depth."""
        i = int(rng.integers(len(scene.frames)))
        last = len(scene.frames) if rng.random() < LATER else i + 1
        there = (rng.random(last) >= MISSED) | (np.arange(last) == i)
        used = _with_sources(scene, i, np.flatnonzero(there), self.settings)
        noise = share_of(self.draws.noise, rng.uniform())
        cameras = disturb_cameras(scene.K[used], scene.world_T_cam[used], noise, rng)
        images = [photometric(scene.image(j), self.draws.augment, rng) for j in used]
        return _swept(scene, used, images, *cameras, self.settings)


def every_sweep(
    capture: Capture, keyframes: Sequence[int], chosen: Sequence[int], settings: StereoSettings
) -> list[SweepBatch]:
    """Sweeps of chosen frames as they are, each against the keyframes before it.

    Returns:
        A batch for each frame; none for those without sources or without depth.
    """
    there, found = np.array(keyframes), []
    for i in chosen:
        used = _with_sources(capture, i, there[there <= i], settings)
        images = [capture.image(j) for j in used] if len(used) > 1 else []
        one = _swept(capture, used, images, capture.K[used], capture.world_T_cam[used], settings)
        found += [joined([one])] if one is not None else []
    return found


def joined(frames: Sequence[SweepBatch]) -> SweepBatch:
    """A batch of frames without the batch axis."""
    return SweepBatch(**{k: torch.stack([vars(f)[k] for f in frames]) for k in vars(frames[0])})


def _with_sources(
    capture: Capture, i: int, there: np.ndarray, settings: StereoSettings
) -> list[int]:
    """Frame i, and its sources of those that are there (i among them)."""
    poses, place = capture.world_T_cam[there], int(np.flatnonzero(there == i)[0])
    sources = choose_sources(poses, place, settings.sources, settings.baseline)
    return [i, *(int(there[j]) for j in sources)]


def _swept(
    capture: Capture,
    used: Sequence[int],
    images: Sequence[np.ndarray],
    K: np.ndarray,
    world_T_cam: np.ndarray,
    settings: StereoSettings,
) -> SweepBatch | None:
    """The sweep of a frame, without the batch axis; ``used`` are it and its sources.

    None without sources, or without depth.
    """
    if len(used) == 1:
        return None
    cameras = zip(images, K, world_T_cam, strict=True)
    view, *sources = [small_view(*camera, settings.width) for camera in cameras]
    depth = Resized(capture, view.grey.shape[::-1]).depth(used[0])
    if depth is None:
        return None
    scores = scores_of(view, sources, settings)
    return SweepBatch(torch.from_numpy(scores), torch.from_numpy(depth))
