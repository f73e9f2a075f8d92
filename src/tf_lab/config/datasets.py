"""From the data group of a config to scene directories, made first where they are missing."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from tf_lab.config.build import chunk_settings
from tf_lab.data import groundtruth
from tf_lab.data.captures import (
    ImportSettings,
    find_captures,
    names_of,
    prepare_captures,
    prepared_scenes,
    scene_of,
)
from tf_lab.data.chunk_sampler import ChunkSampler
from tf_lab.data.chunks import ChunkSource
from tf_lab.data.embedded import EMBEDDED, FIRST_SEED, EmbeddedSet, EmbeddedSplit
from tf_lab.data.readers.settings import ReadSettings
from tf_lab.data.rooms import RoomSettings
from tf_lab.data.scannet_splits import find_scene, split_scenes
from tf_lab.data.shard_set import open_shards
from tf_lab.data.shard_stream import ShardSource
from tf_lab.errors import TFLabError
from tf_lab.training.initial import initial_digests

Config = Mapping[str, Any]
log = logging.getLogger(__name__)


def prepare_data(config: Config, splits: tuple[str, ...]) -> dict[str, list[Path]]:
    """Scene directories of the splits, made first if they are missing.

    Captures that cannot be prepared are logged and left out.

    Raises:
        TFLabError: the data set is unknown or cannot be prepared.
    """
    d = config["data"]
    embedded = embedded_set(config)
    if embedded is None:
        found = captured_scenes(config, splits)
        return {split: list(scenes.values()) for split, scenes in found.items()}
    size = {"train": d["size"], "val": d["val_size"], "test": d["test_size"]}
    frames = {"train": d["frames"], "val": d["test_frames"], "test": d["test_frames"]}
    wanted = {
        s: EmbeddedSplit(size[s], RoomSettings(d["width"], d["height"], frames[s])) for s in splits
    }
    return embedded.prepare(Path(d["root"]).expanduser(), wanted, d["workers"])


def scene_directory(config: Config, name: str, digest: str | None) -> Path:
    """Where a test scene of a resolved config lies, if it has been made on this machine.

    Args:
        config: of a run.
        name: of the scene.
        digest: of a capture's sources, as the run has it.
    """
    d = config["data"]
    embedded = EMBEDDED.get(d["name"])
    if embedded is None:
        return scenes_root(config) / scene_settings(config).key / name / (digest or "unknown")
    index = int(name.rpartition("_")[2]) - FIRST_SEED["test"]
    settings = RoomSettings(d["width"], d["height"], d["test_frames"])
    return embedded.directory(Path(d["root"]).expanduser(), "test", index, settings)


def has_scenes(config: Config, split: str) -> bool:
    """Whether "val" or "test" has a scene, made or still to be made.

    Raises:
        TFLabError: those asked for are not there.
    """
    if embedded_set(config):
        return config["data"][f"{split}_size"] > 0
    known = config.get("scene_digests") or capture_sources(config, (split,))
    return bool(known[split])


def embedded_set(config: Config) -> EmbeddedSet | None:
    """The embedded data set that a config is of; None: it is one of captures.

    Raises:
        TFLabError: it is neither.
    """
    d = config["data"]
    if d["name"] in EMBEDDED:
        return EMBEDDED[d["name"]]
    if d["name"] in ("scannet", "captures") and "scenes" in d:
        return None
    choices = ", ".join(f"data={name}" for name in EMBEDDED)
    raise TFLabError(
        f"data.name={d['name']}: choose the data by {choices}, data=scannet or data=captures"
    )


def training_chunks(config: Config) -> ChunkSource:
    """Where a training's chunks come from: the shards ``data.urls``, or the training scenes.

    Raises:
        TFLabError: the shards cannot be opened, or the scenes cannot be prepared.
    """
    urls = config["data"].get("urls")
    if not urls:
        return training_sampler(config)
    near, far = config["model"]["near"], config["model"]["far"]
    shuffle = config["data"].get("shuffle", True)
    return ShardSource(urls, chunk_settings(config), near, far, shuffle)


def training_sampler(config: Config) -> ChunkSampler:
    """Draws chunks of the training scenes, which are prepared first if they are missing."""
    scenes = prepare_data(config, ("train",))["train"]
    near, far = config["model"]["near"], config["model"]["far"]
    return ChunkSampler(scenes, chunk_settings(config), near, far)


def identified(config: Config) -> Config:
    """A config that says what shapes a run beside the settings: versions, data, files, devices.

    The scenes of captures are made first if they are missing or outdated: what is in them is in
    ``digests``, which go into a run's identity, and the run uses the scenes of ``scene_digests``,
    whatever happens to the captures meanwhile.

    Raises:
        TFLabError: the shards cannot be opened, the scenes not be made, or a file not be read.
    """
    data, trainer = dict(config["data"]), dict(config["trainer"])
    data["version"] = {"groundtruth": groundtruth.VERSION}
    if data["name"] in EMBEDDED:
        data["version"][data["name"]] = EMBEDDED[data["name"]].version
    if data.get("urls"):
        data["identity"] = open_shards(data["urls"]).identity
    if trainer["devices"] in ("auto", -1, "-1"):
        gpus = torch.cuda.device_count() if trainer["accelerator"] != "cpu" else 0
        trainer["devices"] = max(1, gpus)
    digests = initial_digests(config)
    used: Config = {}
    if embedded_set(config) is None:
        splits = ("val", "test") if data.get("urls") else ("train", "val", "test")
        scenes = captured_scenes(config, splits)
        table = {s: {name: d.name for name, d in scenes[s].items()} for s in splits}
        key = scene_settings(config).key
        digests |= {s: _digest([key, *table[s].items()]) for s in ("train", "test") if s in table}
        used = {"scene_digests": table}
    return {**config, **used, "data": data, "trainer": trainer} | (
        {"digests": digests} if digests else {}
    )


def _digest(values: Sequence[Any]) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()[:16]


def captured_scenes(config: Config, splits: tuple[str, ...]) -> dict[str, dict[str, Path]]:
    """Scene directories of captures by name, made first if they are missing or outdated.

    Raises:
        TFLabError: none of a split can be prepared.
    """
    d = config["data"]
    if "scene_digests" in config:
        folder, table = scenes_root(config) / scene_settings(config).key, config["scene_digests"]
        return {s: {name: folder / name / x for name, x in table[s].items()} for s in splits}
    chosen = capture_sources(config, splits)
    sources = {name: path for split in chosen.values() for name, path in split.items()}
    memory = round(d["memory"] * 2**30)
    prepared = prepare_captures(
        sources, scenes_root(config), scene_settings(config), d["workers"], memory
    )
    for name, reason in prepared.failed.items():
        log.warning("scene %s is left out: %s", name, reason)
    found = {
        split: {name: prepared.scenes[name] for name in names if name in prepared.scenes}
        for split, names in chosen.items()
    }
    for split, scenes in found.items():
        if chosen[split] and not scenes:
            raise TFLabError(f"none of the {split} scenes can be prepared, see above")
    return found


def scene_settings(config: Config) -> ImportSettings:
    """How captures become scenes."""
    d = config["data"]
    return ImportSettings(
        width=d["width"],
        height=d["height"],
        keyframe_distance=d["keyframe_distance"],
        read=ReadSettings.of(d),
    )


def scenes_root(config: Config) -> Path:
    """Where the prepared scenes of captures lie."""
    return Path(config["data"]["scenes"]).expanduser()


def capture_sources(config: Config, splits: tuple[str, ...]) -> dict[str, dict[str, Path]]:
    """The captures of each split, by the name of their scene.

    Raises:
        TFLabError: the source is missing, or a split names what is not there.
    """
    d = config["data"]
    root = Path(d["root"]).expanduser()
    limit = {"train": d["size"], "val": d["val_size"], "test": d["test_size"]}
    if d["name"] == "scannet":
        return {s: _scannet_scenes(config, root, s, limit[s]) for s in splits}
    found = _find_captures(config, root)
    names = {split: names_of(d[split] or [], list(found), f"data.{split}") for split in limit}
    held_out = {*names["val"], *names["test"]}
    if d["train"] is None:
        names["train"] = [name for name in found if name not in held_out]
    shared = held_out.intersection(names["train"])
    if shared:
        raise TFLabError(f"data.train: {min(shared)} is held out for val or test as well")
    return {split: {name: found[name] for name in names[split][: limit[split]]} for split in splits}


def _find_captures(config: Config, root: Path) -> dict[str, Path]:
    """The captures in the root; of a root without any, those that scenes were prepared of."""
    try:
        return find_captures(root)
    except TFLabError:
        folder = scenes_root(config) / scene_settings(config).key
        found = {name: root / name for name in prepared_scenes(folder)}
        if not found:
            raise
        log.warning("no capture in %s: the scenes prepared before are used, in %s", root, folder)
        return found


def _scannet_scenes(config: Config, root: Path, split: str, limit: int | None) -> dict[str, Path]:
    """The scenes of a split that are prepared or there to be; says how many are not."""
    prepared = scenes_root(config) / scene_settings(config).key
    found, missing = {}, []
    names = split_scenes(root, split)[:limit]
    for name in names:
        try:
            found[name] = find_scene(root, name)
        except TFLabError as error:
            if scene_of(prepared / name):
                found[name] = root / name  # prepared, when it was there
            else:
                missing.append(error)
    if names and not found:
        raise TFLabError(f"data.root={root}: no {split} scene in it; {missing[0]}")
    if missing:
        log.warning(
            "%d of %d %s scenes are missing: %s", len(missing), len(names), split, missing[0]
        )
    return found
