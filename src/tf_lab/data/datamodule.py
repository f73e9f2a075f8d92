"""The DataModule: endless training chunks, whole scenes for validation and test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import lightning as L
from torch.utils.data import DataLoader

from tf_lab.data.chunks import ChunkBatch, ChunkSampler, ChunkSettings, ChunkStream


def _first(items: list[Path]) -> Path:
    return items[0]


class SceneDataModule(L.LightningDataModule):
    """Chunks of the train split and scene directories of the val split.

    Args:
        splits: scene directories by split.
        settings: how chunks are drawn.
        near, far: valid depth range, metres.
        seed: of the chunk stream.
        workers: loader processes; 0 loads in the training process.
    """

    def __init__(
        self,
        splits: Mapping[str, Sequence[Path]],
        settings: ChunkSettings,
        near: float,
        far: float,
        seed: int,
        workers: int,
    ) -> None:
        super().__init__()
        self.splits, self.settings = splits, settings
        self.near, self.far = near, far
        self.seed, self.workers = seed, workers

    def train_dataloader(self) -> DataLoader[ChunkBatch]:
        """Batches from the trainer's current step on, so that a resumed run goes on with them."""
        sampler = ChunkSampler(self.splits["train"], self.settings, self.near, self.far)
        step = self.trainer.global_step if self.trainer is not None else 0
        rank = self.trainer.global_rank if self.trainer is not None else 0
        return DataLoader(
            ChunkStream(sampler, self.seed, step, rank),
            batch_size=None,
            num_workers=self.workers,
            prefetch_factor=4 if self.workers else None,
        )

    def val_dataloader(self) -> DataLoader[Path]:
        """Scene directories, one at a time."""
        return DataLoader(list(self.splits["val"]), batch_size=1, collate_fn=_first)  # type: ignore[arg-type]
