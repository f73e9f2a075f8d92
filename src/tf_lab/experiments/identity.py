"""Run identity: which settings shape the weights, which only the scores.

A training is found again by the hash of what shapes its weights, so that it is done once, whatever
is asked of it at test time, and an interrupted one goes on. What shapes what is said where a
setting is declared. What lies in files is known by its content (`Content`): the same data elsewhere
is the same training, other data in the same place is another.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from tf_lab.config.schema import TrainConfig
from tf_lab.network.fusion import FUSIONS
from tf_lab.online.views import POLICIES
from tf_lab.support.hashes import hash_of
from tf_lab.support.layout import RUNS, TRAININGS
from tf_lab.support.settings import shaping

PAPER_VIEWS = 16
OF_SCENES = ("size", "frames", "rooms")  # of the data; of shards they say nothing
WATCHING = tuple(  # callbacks that change nothing
    f"lightning.pytorch.callbacks.{name}"
    for name in ("LearningRateMonitor", "DeviceStatsMonitor", "Timer")
)


def training_identity(config: TrainConfig) -> dict[str, Any]:
    """What shapes the weights."""
    identity = shaping(replace(config, test_on=None), "weights")
    if config.content.encoder is not None:  # a file: known by what is in it
        del identity["encoder"]["weights"]
    if config.content.shards is not None:  # in the place of scenes
        identity["loaders"] = max(1, config.trainer.workers)  # each reads a part
        identity["data"] = {k: v for k, v in identity["data"].items() if k not in OF_SCENES}
    devices = config.trainer.devices
    if isinstance(devices, list):  # which ones: how many is what counts
        identity["trainer"]["devices"] = len(devices)
    callbacks = [c for c in config.callbacks.values() if c.get("_target_") not in WATCHING]
    return {**identity, "callbacks": callbacks} if callbacks else identity


def evaluation_identity(config: TrainConfig) -> dict[str, Any]:
    """What shapes the scores, given the training."""
    identity = shaping(replace(config, test_on=None), "scores")
    if config.test_on is None:
        return identity
    # of other data all that shapes scenes, for which of them only its source knows; of the
    # training's nothing
    tested = {**shaping(config.test_on, "weights"), **shaping(config.test_on, "scores")}
    return {**identity, "data": tested}


def key_of(*identity: Any) -> str:
    """A short hash, the same for the same settings."""
    return hash_of(identity, sort_keys=True)


def training_directory(config: TrainConfig) -> Path:
    """Where the training of a config lies."""
    name = [config.model.name, *_changes(config), f"seed{config.seed}"]
    key = key_of(training_identity(config))
    return Path(config.output) / TRAININGS / "-".join([*name, key])


def run_directory(config: TrainConfig) -> Path:
    """Where the evaluation of a config lies."""
    select = POLICIES.named(config.select).choice
    name = [config.model.name, *_changes(config), f"views{config.views}", select]
    key = key_of(training_identity(config), evaluation_identity(config))
    return Path(config.output) / RUNS / "-".join([*name, f"seed{config.seed}", key])


def row_label(config: TrainConfig) -> str:
    """The row of the paper's tables that a config is, whatever all rows of its study share."""
    fusion, policy = FUSIONS.named(config.fusion), POLICIES.named(config.select)
    parts = []
    if fusion.name != "transformer":
        parts = [" ".join([fusion.label or fusion.name, *changed_settings(config.fusion)])]
    parts += [] if config.refine else ["w/o spatial ref."]
    parts += [] if config.filter else ["w/o C2F filter"]
    parts += [] if config.inputs.depth else ["w/o projected depth"]
    parts += [] if config.inputs.ray else ["w/o view ray"]
    parts += ["+ matching"] if config.inputs.matching else []
    parts += ["+ stereo"] if config.inputs.stereo else []
    if config.views != PAPER_VIEWS or policy.name != "attention":
        label = [] if policy.name == "attention" else [policy.label or policy.name]
        selected = " ".join([*label, *changed_settings(config.select)])
        parts.append(f"{config.views} images" + (f", {selected}" if selected else ""))
    return "Ours" + (": " + ", ".join(parts) if parts else "")


def _changes(config: TrainConfig) -> list[str]:
    """Short names of what differs from the full network."""
    fusion, encoder = config.fusion.strategy, config.encoder.name
    names = [fusion] if fusion != "transformer" else []
    names += [] if config.inputs.depth else ["no_depth"]
    names += [] if config.inputs.ray else ["no_ray"]
    names += ["matching"] if config.inputs.matching else []
    names += ["stereo"] if config.inputs.stereo else []
    names += [] if encoder == "resnet" else [encoder]
    names += [] if config.refine else ["no_refine"]
    names += [] if config.filter else ["no_filter"]
    return names


def changed_settings(settings: Any) -> list[str]:
    """The hyper-parameters of a part that are not its defaults."""
    default = type(settings)()
    names = [field.name for field in fields(settings)]
    return [
        f"{name}={getattr(settings, name)}"
        for name in names
        if getattr(settings, name) != getattr(default, name)
    ]
