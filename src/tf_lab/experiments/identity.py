"""Run identity: which settings shape the weights, which only the evaluation (DESIGN).

A training is found again by the hash of what shapes its weights, so that it is done once, whatever
is asked of it at test time, and an interrupted one goes on. What lies in files is known by its
content (``digests``, see `tf_lab.config.datasets.identified`): the same data elsewhere is the same
training, other data in the same place is another.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

TRAINING_GROUPS = ("model", "encoder", "fusion", "inputs", "optimizer", "refine", "filter", "seed")
TRAINING_KEYS = (
    "chunks",
    "images",
    "views",
    "rules",
    "points",
    "near_share",
    "coverage",
    "seen_by",
    "augment",
    "sdf_weight",
)
# of the trainer: how it computes; the rest, such as the number of devices, shapes the weights
TRAINER_MEANS = ("accelerator", "strategy", "compile", "workers")
# of the data group: where it lies and how it is made, which shapes nothing
DATA_PLACES = ("root", "scenes", "urls", "workers", "memory")
PLACES = ("output", "init", "scene_digests")  # of a config; what is in them is in ``digests``
# which scenes of a root: known by their content
DATA_CHOICE = ("train", "size")
DATA_AT_TEST = ("test", "test_size", "test_frames")
DATA_AT_VALIDATION = ("val", "val_size")
# of the policies of view selection: in the names of runs, and in the paper's rows
SELECTIONS = {"attention": "attn", "random": "rnd"}
SELECTION_LABELS = {"attention": "", "random": ", RND"}
TEST_KEYS = ("views", "select", "resolution", "threshold", "keyframe_distance")


def training_identity(config: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a resolved config that shapes the weights."""
    digests = config.get("digests", {})
    identity = {key: config[key] for key in TRAINING_GROUPS}
    if not config["inputs"].get("matching"):  # old trainings had no choice
        identity["inputs"] = {k: v for k, v in config["inputs"].items() if k != "matching"}
    training = config["training"]
    if "rules" not in training:  # old: a share of steps by attention, chunks that all images see
        old = {"rules": {"ranked": training["ranked"]}, "seen_by": training["images"]}
        training = {**old, **training}
    identity["training"] = {key: training[key] for key in TRAINING_KEYS}
    apart = {*DATA_PLACES, *DATA_AT_TEST, *DATA_AT_VALIDATION}
    apart |= set(DATA_CHOICE if "train" in digests else ())
    identity["data"] = {k: v for k, v in config["data"].items() if k not in apart}
    identity["trainer"] = {k: v for k, v in config["trainer"].items() if k not in TRAINER_MEANS}
    if "encoder" in digests:
        identity["encoder"] = {k: v for k, v in identity["encoder"].items() if k != "weights"}
    if shaping := {k: v for k, v in digests.items() if k != "test"}:
        identity["digests"] = shaping
    return identity


def evaluation_identity(config: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a resolved config that shapes the scores, given the training."""
    identity = {key: config[key] for key in TEST_KEYS}
    precision = config.get("online", {}).get("precision", "float32")  # old runs had no choice
    if precision != "float32":  # the rest of the group changes no number
        identity["precision"] = precision
    identity["data"] = {k: v for k, v in config["data"].items() if k in DATA_AT_TEST}
    if "test" in config.get("digests", {}):
        identity["data"] = {"digest": config["digests"]["test"]}
    return identity


def key_of(*identity: Mapping[str, Any]) -> str:
    """A short hash, the same for the same settings."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:10]


def training_directory(config: Mapping[str, Any]) -> Path:
    """Where the training of a resolved config lies."""
    name = [config["model"]["name"], *_changes(config), f"seed{config['seed']}"]
    key = key_of(training_identity(config))
    return Path(config["output"]) / "trainings" / "-".join([*name, key])


def run_directory(config: Mapping[str, Any]) -> Path:
    """Where the evaluation of a resolved config lies."""
    select = SELECTIONS.get(config["select"]["policy"], config["select"]["policy"])
    name = [config["model"]["name"], *_changes(config), f"views{config['views']}", select]
    key = key_of(training_identity(config), evaluation_identity(config))
    return Path(config["output"]) / "runs" / "-".join([*name, f"seed{config['seed']}", key])


def portable(config: Mapping[str, Any]) -> dict[str, Any]:
    """A config without the paths of this machine, as it may travel with a checkpoint."""
    data = {k: v for k, v in config["data"].items() if k not in DATA_PLACES}
    return {**{k: v for k, v in config.items() if k not in PLACES}, "data": data}


def row_label(config: Mapping[str, Any]) -> str:
    """The row of the paper's tables that a config is."""
    parts = []
    if config["fusion"]["strategy"] != "transformer":
        parts.append(f"w/o TRSF, {config['fusion']['strategy']}")
    if not config["refine"]:
        parts.append("w/o spatial ref.")
    if not config["filter"]:
        parts.append("w/o C2F filter")
    if not config["inputs"]["depth"]:
        parts.append("w/o projected depth")
    if not config["inputs"]["ray"]:
        parts.append("w/o view ray")
    if (encoder := _encoder(config)) != "resnet":
        parts.append(f"{encoder} encoder")
    if config["inputs"].get("matching"):
        parts.append("+ matching")
    policy = config["select"]["policy"]
    if config["views"] != 16 or policy != "attention":
        parts.append(f"{config['views']} images" + SELECTION_LABELS.get(policy, f", {policy}"))
    return "Ours" + (": " + ", ".join(parts) if parts else "")


def _encoder(config: Mapping[str, Any]) -> str:
    """The kind of encoder; old configs, which name none, have a ResNet."""
    return config.get("encoder", {}).get("name", "resnet")


def _changes(config: Mapping[str, Any]) -> list[str]:
    """Short names of what differs from the full network."""
    names = []
    if config["fusion"]["strategy"] != "transformer":
        names.append(config["fusion"]["strategy"])
    names += [] if config["inputs"]["depth"] else ["no_depth"]
    names += [] if config["inputs"]["ray"] else ["no_ray"]
    names += ["matching"] if config["inputs"].get("matching") else []
    names += [] if _encoder(config) == "resnet" else [_encoder(config)]
    names += [] if config["refine"] else ["no_refine"]
    names += [] if config["filter"] else ["no_filter"]
    return names
