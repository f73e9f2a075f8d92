"""Training chunks streamed from shards: shuffled, and split over processes without overlap."""

from __future__ import annotations

import logging
import tarfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import islice
from typing import Any

import numpy as np
import webdataset
from torch.utils.data import IterableDataset, get_worker_info
from webdataset.tariterators import group_by_keys

from tf_lab.data.chunks import ChunkBatch, ChunkRecord, make_batch
from tf_lab.data.settings import ChunkSettings
from tf_lab.data.shard_set import Shard, ShardSet, open_shards
from tf_lab.data.shards import decode
from tf_lab.errors import TFLabError

log = logging.getLogger(__name__)
SIZE = ("width", "height")  # of the images, in shards that say it
GROUPS = {"near": "model", "far": "model", "width": "data", "height": "data"}  # of settings


class ShardSource:
    """Training chunks from shards; see `ChunkSource`.

    Args:
        urls: see `open_shards`.
        settings: as the shards were drawn; fewer images than they hold will do.
        near, far: valid depth range, metres.
        shuffle: whether every epoch has an order of its own. Without, one process meets the
            chunks in the order in which the folders' stream of the shards' seed draws them.
        size: (width, height) of the images; None: any.

    Raises:
        TFLabError: the shards cannot be opened, or were drawn in another way.
    """

    def __init__(
        self,
        urls: str | Sequence[str],
        settings: ChunkSettings,
        near: float,
        far: float,
        shuffle: bool = True,
        size: tuple[int, int] | None = None,
    ) -> None:
        self.shards, self.settings, self.shuffle = open_shards(urls), settings, shuffle
        sizes = {} if size is None else dict(zip(SIZE, size, strict=True))
        wanted = {**vars(settings), "near": near, "far": far, **sizes}
        for name, value in self.shards.settings.items():
            if name == "images" and value >= settings.images:
                continue  # any of them will do
            if name in SIZE and size is None:
                continue
            if wanted.get(name) != value:
                group = GROUPS.get(name, "training")
                raise TFLabError(
                    f"the shards were written with {group}.{name}={value}, not {wanted.get(name)}; "
                    "train with that, or write others"
                )

    def stream(self, seed: int, first_step: int, rank: int, world: int) -> ShardStream:
        """See `ChunkSource`."""
        return ShardStream(
            self.shards, self.settings, seed, first_step, rank, world, shuffle=self.shuffle
        )


class ShardStream(IterableDataset[ChunkBatch]):
    """An endless stream of batches in which every chunk comes exactly once an epoch.

    An epoch is all chunks in one order: the shards shuffled, and the chunks in each. Each loader
    worker of each process has an equal, contiguous part of that order, so it reads no more shards
    than it needs, and processes share a shard only where two parts meet (or where there are fewer
    shards than processes). Batches follow each other without regard to the ends of epochs.

    A batch is a function of the seed, the step and the numbers of processes and workers: resumed
    at a step, the stream goes on as it would have. A damaged chunk is left out of its batch; in the
    place of a batch that has no whole chunk comes the next one that has.

    Args:
        shards: where the chunks lie.
        settings: of the batches.
        seed: of the order, and of the choices of the steps.
        first_step: where to start.
        rank: of this process in distributed training.
        world: how many processes there are.
        shuffle: see `ShardSource`.
    """

    def __init__(
        self,
        shards: ShardSet,
        settings: ChunkSettings,
        seed: int,
        first_step: int = 0,
        rank: int = 0,
        world: int = 1,
        shuffle: bool = True,
    ) -> None:
        self.shards, self.settings, self.seed = shards, settings, seed
        self.first_step, self.rank, self.world, self.shuffle = first_step, rank, world, shuffle

    def __iter__(self) -> Iterator[ChunkBatch]:
        worker = get_worker_info()
        offset, workers = (worker.id, worker.num_workers) if worker else (0, 1)
        step = self.first_step + offset  # the loader asks its workers in turn
        low, high = self._part(step % workers, workers)
        batch_size = self.settings.chunks
        records = self._records(low, high, (step // workers) * batch_size)
        due = 0  # batches: this one, and those before it that had no whole chunk
        while True:
            batch, due = [r for r in islice(records, batch_size) if r is not None], due + 1
            if not batch and due * batch_size > high - low:
                raise TFLabError(f"{self.shards.shards[0].url}: no chunk in an epoch is whole")
            while batch and due:
                yield make_batch(batch, self.settings, self.seed, self.rank, step)
                step, due = step + workers, due - 1

    def _part(self, worker: int, workers: int) -> tuple[int, int]:
        """The positions, from and up to, that a worker of this process has in every epoch."""
        parts, total = self.world * workers, self.shards.records
        if parts > total:
            raise TFLabError(
                f"{total} chunks in the shards, fewer than the {parts} loader processes; use "
                "fewer (trainer.workers)"
            )
        part = self.rank * workers + worker
        return total * part // parts, total * (part + 1) // parts

    def _records(self, low: int, high: int, skip: int) -> Iterator[ChunkRecord | None]:
        """The chunks of one part, epoch after epoch, without the first ``skip``."""
        epoch, done = divmod(skip, high - low)
        while True:
            yield from self._epoch(epoch, low + done, high)
            epoch, done = epoch + 1, 0

    def _epoch(self, epoch: int, low: int, high: int) -> Iterator[ChunkRecord | None]:
        """The chunks from one position of an epoch's order up to another."""
        rng = np.random.default_rng([self.seed, epoch])
        shards, first = self.shards.shards, 0
        for i in rng.permutation(len(shards)) if self.shuffle else range(len(shards)):
            count = shards[i].records
            order = rng.permutation(count) if self.shuffle else np.arange(count)
            wanted = order[max(0, low - first) : max(0, high - first)]
            if len(wanted):
                yield from read_records(shards[i], wanted.tolist())
            first += count


def read_records(shard: Shard, wanted: Sequence[int]) -> Iterator[ChunkRecord | None]:
    """Some chunks of a shard, in the order asked for; None for a damaged one, which is logged.

    Args:
        shard: read from its start, as far as needed.
        wanted: which chunks, by their place in the shard; they are held in memory.

    Raises:
        TFLabError: the shard cannot be read, or is cut off.
    """
    samples = _read(shard, frozenset(wanted))
    damaged = 0
    for position in wanted:
        sample = samples.pop(position)
        try:
            yield decode(sample)
        except ValueError as error:
            damaged += 1
            log.warning(
                "%s: chunk %s is damaged (%s) and left out; number %d of this shard",
                *(shard.url, sample.get("__key__"), error, damaged),
            )
            yield None


def _read(shard: Shard, wanted: frozenset[int]) -> dict[int, Any]:
    """The samples at some places of a shard."""
    found: dict[int, Any] = {}
    try:
        with closing(group_by_keys(_members(shard))) as samples:
            for position, sample in enumerate(samples):
                if position in wanted:
                    found[position] = sample
                if len(found) == len(wanted):
                    return found
    except Exception as error:  # whatever opens it, and whatever is in it
        reason = str(error.args[0] if error.args else error).splitlines()[0]
        raise TFLabError(
            f"{shard.url}: the shard cannot be read ({reason}); copy or write it again"
        ) from error
    raise TFLabError(
        f"{shard.url}: the shard ends before its {shard.records} chunks; copy or write it again"
    )


def _members(shard: Shard) -> Iterator[dict[str, Any]]:
    """The files in a shard as webdataset groups them; what a shard has no need of is refused."""
    with (
        webdataset.gopen(shard.url) as stream,
        tarfile.open(fileobj=stream, mode="r|") as tar,  # not compressed, which has no bounds
    ):
        for member in tar:
            if not member.isreg() or member.issparse() or member.size > shard.bytes:
                raise ValueError(f"{member.name[:60]!r} in it is no file of its size")
            file = tar.extractfile(member)
            assert file is not None  # it is regular
            yield {"fname": member.name, "data": file.read(), "__url__": shard.url}
            tar.members = []  # type: ignore[attr-defined]  # else they are all kept
