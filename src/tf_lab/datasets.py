"""From the data group of a config to scene directories, made first where they are missing."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from tf_lab.configuration import chunk_settings
from tf_lab.data import groundtruth
from tf_lab.data.captures import ImportSettings, find_captures, names_of, prepare_captures
from tf_lab.data.chunk_sampler import ChunkSampler
from tf_lab.data.chunks import ChunkSource
from tf_lab.data.embedded import EMBEDDED, FIRST_SEED, EmbeddedSet, EmbeddedSplit
from tf_lab.data.readers.settings import ReadSettings
from tf_lab.data.rooms import RoomSettings
from tf_lab.data.scannet_splits import find_scene, split_scenes
from tf_lab.data.shard_set import open_shards
from tf_lab.data.shard_stream import ShardSource
from tf_lab.errors import TFLabError

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
        return _prepare_captures(config, splits)
    size = {"train": d["size"], "val": d["val_size"], "test": d["test_size"]}
    frames = {"train": d["frames"], "val": d["test_frames"], "test": d["test_frames"]}
    wanted = {
        s: EmbeddedSplit(size[s], RoomSettings(d["width"], d["height"], frames[s])) for s in splits
    }
    return embedded.prepare(Path(d["root"]).expanduser(), wanted, d["workers"])


def scene_directory(config: Config, name: str) -> Path:
    """Where a test scene of a resolved config lies, if it has been made on this machine."""
    d = config["data"]
    embedded = EMBEDDED.get(d["name"])
    if embedded is None:
        return scenes_root(config) / scene_settings(config).key / name
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
    return bool(capture_sources(config, (split,))[split])


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
    """A config that says what shapes a run beside the settings: versions, shards, devices.

    Raises:
        TFLabError: the shards cannot be opened.
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
    return {**config, "data": data, "trainer": trainer}


def _prepare_captures(config: Config, splits: tuple[str, ...]) -> dict[str, list[Path]]:
    d = config["data"]
    chosen = capture_sources(config, splits)
    sources = {name: path for split in chosen.values() for name, path in split.items()}
    memory = round(d["memory"] * 2**30)
    prepared = prepare_captures(
        sources, scenes_root(config), scene_settings(config), d["workers"], memory
    )
    for name, reason in prepared.failed.items():
        log.warning("scene %s is left out: %s", name, reason)
    found = {
        split: [prepared.scenes[name] for name in names if name in prepared.scenes]
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
    found = find_captures(root)
    names = {split: names_of(d[split] or [], list(found), f"data.{split}") for split in limit}
    held_out = {*names["val"], *names["test"]}
    if d["train"] is None:
        names["train"] = [name for name in found if name not in held_out]
    shared = held_out.intersection(names["train"])
    if shared:
        raise TFLabError(f"data.train: {min(shared)} is held out for val or test as well")
    return {split: {name: found[name] for name in names[split][: limit[split]]} for split in splits}


def _scannet_scenes(config: Config, root: Path, split: str, limit: int | None) -> dict[str, Path]:
    """The scenes of a split that are prepared or there to be; says how many are not."""
    prepared = scenes_root(config) / scene_settings(config).key
    found, missing = {}, []
    names = split_scenes(root, split)[:limit]
    for name in names:
        try:
            found[name] = prepared / name if (prepared / name).is_dir() else find_scene(root, name)
        except TFLabError as error:
            missing.append(error)
    if names and not found:
        raise TFLabError(f"data.root={root}: no {split} scene in it; {missing[0]}")
    if missing:
        log.warning(
            "%d of %d %s scenes are missing: %s", len(missing), len(names), split, missing[0]
        )
    return found
