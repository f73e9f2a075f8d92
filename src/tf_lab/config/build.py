"""From the composed config to the objects it describes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from tf_lab.cli.command import device_of
from tf_lab.data.chunks import ChunkSettings
from tf_lab.errors import TFLabError
from tf_lab.network.checkpoint import shipped_encoder
from tf_lab.network.encoders.pyramid import Encoder
from tf_lab.network.encoders.weights import load_encoder_weights
from tf_lab.network.network import Network
from tf_lab.network.settings import NetworkConfig
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.online.views import make_policy
from tf_lab.training.initial import initial_path, initialise
from tf_lab.training.module import OptimizerSettings

Config = Mapping[str, Any]


def make_network(config: Config) -> Network:
    """The network, initialised as ``init`` says, or its encoder as ``encoder.weights`` does."""
    network = build_network(config)
    start = initial_path(config)
    if start is not None:
        initialise(network, start)
    else:
        initialise_encoder(network.encoder, config, config["encoder"]["weights"])
    return network


def build_network(config: Config) -> Network:
    """The network with random weights.

    Raises:
        TFLabError: it cannot be.
    """
    model = {k: v for k, v in config["model"].items() if k != "name"}
    try:
        return Network(
            NetworkConfig(
                **model,
                encoder=encoder_settings(config),
                fusion=config["fusion"],
                depth=config["inputs"]["depth"],
                ray=config["inputs"]["ray"],
                matching=config["inputs"]["matching"],
                refine=config["refine"],
                filter=config["filter"],
            )
        )
    except TypeError as error:
        raise TFLabError(f"model, encoder: {error}; see the files in conf/model") from error


def encoder_settings(config: Config) -> dict[str, Any]:
    """What `make_encoder` takes."""
    return {k: v for k, v in config["encoder"].items() if k != "weights"}


def initialise_encoder(encoder: Encoder, config: Config, source: str) -> None:
    """Load the weights that ``encoder.weights=source`` means for a config."""
    shipped = shipped_encoder(config["model"]["name"], config["encoder"]["name"])
    load_encoder_weights(encoder, source, shipped)


def chunk_settings(config: Config) -> ChunkSettings:
    """How training chunks are drawn.

    Raises:
        TFLabError: a rule of view selection that there is not, or no rule at all.
    """
    t = config["training"]
    rules = {name: weight for name, weight in t["rules"].items() if weight > 0}
    for name in rules:
        make_policy(name, 0)
    if not rules:
        raise TFLabError("training.rules: all weights are 0; give at least one rule some")
    return ChunkSettings(
        chunks=t["chunks"],
        images=t["images"],
        views=tuple(t["views"]),
        rules=rules,
        points=t["points"],
        near_share=t["near_share"],
        coverage=t["coverage"],
        seen_by=t["seen_by"],
        augment=t["augment"],
    )


def optimizer_settings(config: Config) -> OptimizerSettings:
    """Adam and its schedule."""
    values = dict(config["optimizer"])
    values["betas"] = tuple(values["betas"])
    try:
        return OptimizerSettings(**values)
    except TypeError as error:
        raise TFLabError(f"optimizer: {error}; see the files in conf/model") from error


def reconstruction_settings(config: Config, **others: Any) -> ReconstructionSettings:
    """Mesh resolution and what the group ``online`` says; ``others`` as they are.

    Raises:
        TFLabError: a value that cannot be, or a device that is not there.
    """
    online, budget = config["online"], config["online"]["maps_budget"]
    device = online["maps_device"]
    return ReconstructionSettings(
        resolution=config["resolution"],
        batch=online["batch"],
        precision=online["precision"],
        maps=online["precision"],
        maps_device=None if device == "auto" else str(device_of(device)),
        maps_budget=None if budget is None else round(budget * 2.0**30),
        **others,
    )


def ready(network: Network, config: Config, device: torch.device) -> Network:
    """A network on the device that it reconstructs on, compiled if ``online.compile`` says so."""
    if config["online"]["compile"]:
        network.compile_parts()
    return network.to(device)


def test_settings(config: Config) -> ReconstructionSettings:
    """How scenes are reconstructed at test time."""
    return reconstruction_settings(
        config,
        views=config["views"],
        threshold=config["threshold"],
        select=config["select"],
        seed=config["seed"],
        keyframe_distance=config["keyframe_distance"],
    )
