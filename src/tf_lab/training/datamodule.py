"""The DataModules: endless streams to train on, scenes or batches for validation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Generic, TypeVar

import lightning as L
import torch
from torch.utils.data import DataLoader, IterableDataset

from tf_lab.data.chunks import ChunkBatch, ChunkSource
from tf_lab.training.evaluation import scene_loader

T = TypeVar("T")


def batches_done(trainer: L.Trainer) -> int:
    """How many batches of a training each process has had."""
    return trainer.global_step * trainer.accumulate_grad_batches


class SceneDataModule(L.LightningDataModule):
    """Training chunks, and scene directories for validation.

    Args:
        train: where the chunks come from.
        val: scene directories.
        seed: of the chunk stream.
        workers: loader processes; 0 loads in the training process.
    """

    def __init__(self, train: ChunkSource, val: Sequence[Path], seed: int, workers: int) -> None:
        super().__init__()
        self.train, self.val = train, val
        self.seed, self.workers = seed, workers

    def train_dataloader(self) -> DataLoader[ChunkBatch]:
        """Batches from the trainer's current step on, so that a resumed run goes on with them."""
        step, rank, world = 0, 0, 1
        if self.trainer is not None:
            step, rank = batches_done(self.trainer), self.trainer.global_rank
            world = self.trainer.world_size
        return DataLoader(
            self.train.stream(self.seed, step, rank, world),
            batch_size=None,
            num_workers=self.workers,
            prefetch_factor=4 if self.workers else None,
            pin_memory=torch.cuda.is_available(),
        )

    def val_dataloader(self) -> DataLoader[Path | None]:
        """Scene directories, one at a time; each is one process's."""
        return scene_loader(self.val, self.trainer)


class StreamDataModule(L.LightningDataModule, Generic[T]):
    """A stream of batches to train on, and fixed ones for validation.

    Args:
        train: the batches from a step on.
        val: batches of every set that is validated on.
        workers: loader processes; 0 loads in the training process.
    """

    def __init__(
        self,
        train: Callable[[int], IterableDataset[T]],
        val: Sequence[Sequence[T]],
        workers: int,
    ) -> None:
        super().__init__()
        self.train, self.val, self.workers = train, val, workers

    def train_dataloader(self) -> DataLoader[T]:
        """Batches from the trainer's current step on, so that a resumed run goes on with them."""
        step = batches_done(self.trainer) if self.trainer is not None else 0
        return DataLoader(
            self.train(step),
            batch_size=None,
            num_workers=self.workers,
            pin_memory=torch.cuda.is_available(),
        )

    def val_dataloader(self) -> list[DataLoader[T]]:
        """A loader for every set."""
        return [DataLoader(list(batches), batch_size=None) for batches in self.val]  # type: ignore[arg-type]
