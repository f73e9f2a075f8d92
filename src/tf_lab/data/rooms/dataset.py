"""The embedded data set: rooms rendered once into a cache, with ground truth from their depth."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from tf_lab.data import groundtruth, scene
from tf_lab.data.groundtruth import GroundTruthSettings, write_groundtruth
from tf_lab.data.preparation import SceneJob, prepare_scenes
from tf_lab.data.rooms import VERSION, RoomSettings, generate_room
from tf_lab.data.scene import write_scene

FIRST_SEED = {"train": 0, "val": 1_000_000, "test": 2_000_000}  # splits never share a room


@dataclass(frozen=True)
class RoomSplit:
    """How many rooms a split has and how they are rendered."""

    size: int
    settings: RoomSettings


def room_directory(root: Path, split: str, index: int, settings: RoomSettings) -> Path:
    """Where a room lies: everything that shapes it is in the path, so a cache never goes stale."""
    versions = [VERSION, scene.FORMAT, groundtruth.VERSION]
    identity = json.dumps([*versions, asdict(settings), asdict(GroundTruthSettings())])
    key = hashlib.sha256(identity.encode()).hexdigest()[:10]
    return root / f"rooms-{key}" / split / f"room_{FIRST_SEED[split] + index:07d}"


def build_room(directory: Path, seed: int, settings: RoomSettings) -> None:
    """Render a room and its ground truth into a directory (see `scene` and `groundtruth`)."""
    provenance = {"source": "rooms", "seed": seed, "version": VERSION, **asdict(settings)}
    room = write_scene(
        directory, generate_room(seed, settings), provenance, name=f"room_{seed:07d}"
    )
    write_groundtruth(room, room.groundtruth, GroundTruthSettings())


def prepare_rooms(
    root: Path, splits: Mapping[str, RoomSplit], workers: int | None = None
) -> dict[str, list[Path]]:
    """Render what is missing and return the scene directories of each split.

    Args:
        root: the cache.
        splits: by name: "train", "val", "test".
        workers: processes; None: one a core.
    """
    found: dict[str, list[Path]] = {}
    jobs = []
    for split, wanted in splits.items():
        found[split] = []
        for i in range(wanted.size):
            directory = room_directory(root, split, i, wanted.settings)
            seed = FIRST_SEED[split] + i
            found[split].append(directory)
            jobs.append(
                SceneJob(directory, partial(build_room, seed=seed, settings=wanted.settings))
            )
    prepare_scenes(jobs, "rendering rooms", workers)
    return found
