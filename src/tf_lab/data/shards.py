"""Shards: chunks in tar files of webdataset's layout, for clusters and object storage.

A directory of shards::

    chunks-000000.tar   chunks one after the other; the members of one have its number for a name:
        00000000.json          scene, frames, image size, and a checksum of what follows
        00000000.safetensors   cameras, targets, points, signed distances (see `ChunkRecord`)
        00000000.00.jpg ...    the images, byte by byte as the scene stores them
    shards.json         written last: how the chunks were drawn, and what the shards must be
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.torch import load, save
from webdataset import TarWriter

from tf_lab.data.chunk_sampler import ChunkSampler
from tf_lab.data.chunks import COARSE_GRID, FINE_GRID, ChunkRecord
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.support.documents import parse_json, read_json
from tf_lab.support.files import atomic_path, remove_abandoned, write_json
from tf_lab.support.records import record
from tf_lab.support.tasks import run_tasks

FORMAT = 1
INDEX = "shards.json"
PLAN = "plan.json"
CHOSEN_BY_STEP = ("chunks", "views", "rules", "camera_noise")  # they shape no chunk
TENSORS = ("K", "world_T_cam", "coarse_target", "fine_target", "points", "sdf")


@dataclass(frozen=True)
class Description:
    """What a chunk's JSON holds."""

    scene: str
    frames: list[str]
    size: tuple[int, int]
    crc32: int


def encode(chunk: ChunkRecord) -> dict[str, bytes]:
    """A record as the members of a shard, by their suffix."""
    members = {"safetensors": save({k: getattr(chunk, k).contiguous() for k in TENSORS})}
    members |= {f"{i:02d}.jpg": image for i, image in enumerate(chunk.images)}
    name, frames = Path(chunk.scene).name, list(chunk.frames)
    meta = Description(name, frames, chunk.size, _checksum(members))
    return {**members, "json": json.dumps(asdict(meta)).encode()}


def decode(sample: Mapping[str, Any]) -> ChunkRecord:
    """The record of a sample as webdataset reads it.

    Raises:
        ValueError: the sample is damaged.
    """
    members = {k: v for k, v in sample.items() if not k.startswith("__") and k != "json"}
    try:
        meta = record(Description, parse_json(sample["json"]))
        if _checksum(members) != meta.crc32:
            raise ValueError("its checksum is wrong")
        count = len(meta.frames)
        chunk = ChunkRecord(
            scene=meta.scene,
            frames=meta.frames,
            size=meta.size,
            images=[members[f"{i:02d}.jpg"] for i in range(count)],
            **load(members["safetensors"]),
        )
        shapes: list[tuple[int, ...]]
        shapes = [(count, 3, 3), (count, 4, 4), COARSE_GRID.shape, FINE_GRID.shape]
        shapes += [(len(chunk.sdf), 3), (len(chunk.sdf),)]
        for name, shape in zip(TENSORS, shapes, strict=True):
            if getattr(chunk, name).shape != shape:
                raise ValueError(f"{name} has shape {list(getattr(chunk, name).shape)}")
        return chunk
    except Exception as error:  # any damage: missing members, no JSON, other keys
        raise ValueError(f"{type(error).__name__}: {error}") from error


def _checksum(members: Mapping[str, bytes]) -> int:
    value = 0
    for name in sorted(members):
        value = zlib.crc32(members[name], zlib.crc32(name.encode(), value))
    return value


def shard_name(number: int) -> str:
    """The file name of a shard."""
    return f"chunks-{number:06d}.tar"


def write_shards(
    directory: Path,
    sampler: ChunkSampler,
    count: int,
    seed: int = 0,
    per_shard: int = 64,
    provenance: Mapping[str, Any] | None = None,
    workers: int | None = None,
) -> Path:
    """Write ``count`` chunks, each a function of the seed and its number, one process a shard.

    Whole shards that are there already are kept, so that an interrupted writing goes on.

    Args:
        directory: for the shards of this set alone.
        sampler: draws the chunks; its ``images`` are stored of each, of which training may use
            fewer.
        count: of chunks in all.
        seed: of all chunks. Those of the folders' stream of this seed are the same.
        per_shard: chunks a shard; a reader keeps as many in memory.
        provenance: kept in the index, where it shapes nothing.
        workers: processes; None: one a core.

    Returns:
        The index.

    Raises:
        TFLabError: the directory holds other chunks, or some could not be drawn.
    """
    if count < 1 or per_shard < 1:
        raise TFLabError(f"{count} chunks, {per_shard} a shard: both must be 1 or more")
    plan = _plan(sampler, count, seed, per_shard)
    _claim(directory, plan)
    index = directory / INDEX
    numbers = {
        shard_name(i): range(first, min(first + per_shard, count))
        for i, first in enumerate(range(0, count, per_shard))
    }
    tasks = {
        name: partial(_write_shard, directory / name, sampler, seed, indices)
        for name, indices in numbers.items()
        if not (directory / name).exists()
    }
    if index.exists() and not tasks:
        return index
    if tasks:
        failed = run_tasks(tasks, "writing shards", workers)
        for name, reason in failed.items():
            raise TFLabError(f"{len(failed)} of {len(tasks)} shards failed, first {name}: {reason}")
    shards = [_entry(directory / name, len(indices)) for name, indices in numbers.items()]
    write_json(index, {**plan, "shards": shards, "provenance": dict(provenance or {})})
    return index


def _plan(sampler: ChunkSampler, count: int, seed: int, per_shard: int) -> dict[str, Any]:
    """All that shapes the chunks."""
    drawn = {k: v for k, v in asdict(sampler.settings).items() if k not in CHOSEN_BY_STEP}
    digest = hashlib.sha256()
    for scene in sampler.scenes:
        for name in ("scene.json", "cameras.npz", "groundtruth/chunks.npz"):
            try:
                digest.update((scene / name).read_bytes())
            except OSError as error:
                raise TFLabError(
                    f"{scene / name}: cannot be read ({error.strerror}); prepare the scene again"
                ) from error
    return {
        "format": FORMAT,
        "settings": {
            **drawn,
            **{"near": sampler.near, "far": sampler.far},
            **dict(zip(("width", "height"), Scene(sampler.scenes[0]).size, strict=True)),
        },
        "seed": seed,
        "count": count,
        "per_shard": per_shard,
        "scenes": [scene.name for scene in sampler.scenes],
        "scenes_sha256": digest.hexdigest(),
    }


def _claim(directory: Path, plan: Mapping[str, Any]) -> None:
    """See to it that a directory is for the chunks of this plan alone.

    Raises:
        TFLabError: it is for others.
    """
    directory.mkdir(parents=True, exist_ok=True)
    remove_abandoned(directory)
    path = directory / PLAN
    shards = list(directory.glob("chunks-*.tar"))  # before the plan: it is written before them
    if not path.exists():
        if shards:
            raise TFLabError(f"{directory}: has shards of unknown origin; choose another directory")
        write_json(path, plan)
    found = read_json(path, f"delete {directory}")
    if found != plan:
        found = found if isinstance(found, dict) else {}
        other = next(k for k in {**plan, **found} if plan.get(k) != found.get(k))
        raise TFLabError(
            f"{directory}: is for other chunks ({other}: {str(found.get(other))[:60]}); choose "
            "another directory, or delete this one"
        )


def _write_shard(path: Path, sampler: ChunkSampler, seed: int, indices: range) -> None:
    if path.exists():  # another process was faster
        return
    with (
        atomic_path(path) as temporary,
        temporary.open("wb") as file,
        # the same bytes whenever and by whomever it is written
        TarWriter(file, encoder=False, mtime=0, user="", group="", mode=0o644) as tar,
    ):
        for index in indices:
            chunk = sampler.record(seed, index)
            width, height = chunk.size  # a damaged image is told now, not in training
            count = len(chunk.images)
            chunk.decode(range(count), np.empty((count, 3, height, width), np.uint8))
            tar.write({"__key__": f"{index:08d}", **encode(chunk)})


def _entry(path: Path, records: int) -> dict[str, Any]:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256")
    size = path.stat().st_size
    return {"name": path.name, "records": records, "bytes": size, "sha256": digest.hexdigest()}
