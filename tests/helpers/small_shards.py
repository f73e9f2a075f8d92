"""Shards of few, small chunks, written without the cost of starting processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
import torch
from torch import Tensor

from tf_lab.data import shards
from tf_lab.data.chunk_sampler import ChunkSampler
from tf_lab.data.chunks import ChunkBatch
from tf_lab.data.settings import ChunkSettings
from tf_lab.errors import TFLabError

NEAR, FAR = 0.3, 5.0
RULES = {"attention": 1.0, "random": 1.0}
SETTINGS = ChunkSettings(chunks=2, images=3, points=40, coverage=0.2, views=(2, 3), rules=RULES)
COUNT, SEED = 16, 4


def sampler(scene: Path, settings: ChunkSettings = SETTINGS) -> ChunkSampler:
    """Draws small chunks."""
    return ChunkSampler([scene], settings, NEAR, FAR)


def same(a: ChunkBatch, b: ChunkBatch) -> bool:
    """Whether two batches are equal in all they hold."""
    return all(
        torch.equal(torch.nan_to_num(x, -7), torch.nan_to_num(y, -7))
        if isinstance(x, Tensor)
        else x == y
        for x, y in zip(vars(a).values(), vars(b).values(), strict=True)
    )


def run_here(tasks: Mapping[str, Callable[[], None]], *_: object) -> dict[str, str]:
    """As `run_tasks`, in this process."""
    failed = {}
    for name, task in tasks.items():
        try:
            task()
        except TFLabError as error:
            failed[name] = str(error)
    return failed


def write(directory: Path, drawn: ChunkSampler, count: int = COUNT, per_shard: int = 5) -> None:
    """Write shards in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shards, "run_tasks", run_here)
        shards.write_shards(directory, drawn, count, SEED, per_shard)
