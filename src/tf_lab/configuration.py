"""From the composed config to the objects it describes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from tf_lab.checkpoint import shipped_encoder
from tf_lab.commands import device_of
from tf_lab.data.chunks import ChunkSettings
from tf_lab.errors import TFLabError
from tf_lab.initial import initial_path, initialise
from tf_lab.network.encoder import load_encoder_weights
from tf_lab.network.network import Network, NetworkConfig
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.scoring import TestSettings
from tf_lab.training import OptimizerSettings

Config = Mapping[str, Any]


def make_network(config: Config) -> Network:
    """The network, initialised as ``init`` says, or its encoder as ``encoder.weights`` does."""
    network = build_network(config)
    start = initial_path(config)
    if start is not None:
        initialise(network, start)
    else:
        shipped = shipped_encoder(config["model"]["name"])
        load_encoder_weights(network.encoder, config["encoder"]["weights"], shipped)
    return network


def build_network(config: Config) -> Network:
    """The network with random weights.

    Raises:
        TFLabError: it cannot be.
    """
    model = {k: v for k, v in config["model"].items() if k != "name"}
    encoder = {k: v for k, v in config["encoder"].items() if k != "weights"}
    try:
        return Network(
            NetworkConfig(
                **model,
                encoder=encoder,
                fusion=config["fusion"]["strategy"],
                depth=config["inputs"]["depth"],
                ray=config["inputs"]["ray"],
                refine=config["refine"],
                filter=config["filter"],
            )
        )
    except TypeError as error:
        raise TFLabError(f"model, encoder: {error}; see the files in conf/model") from error


def chunk_settings(config: Config) -> ChunkSettings:
    """How training chunks are drawn."""
    t = config["training"]
    return ChunkSettings(
        chunks=t["chunks"],
        images=t["images"],
        views=tuple(t["views"]),
        ranked=t["ranked"],
        points=t["points"],
        near_share=t["near_share"],
        coverage=t["coverage"],
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


def test_settings(config: Config) -> TestSettings:
    """How scenes are reconstructed at test time."""
    return TestSettings(
        reconstruction=reconstruction_settings(
            config, views=config["views"], threshold=config["threshold"]
        ),
        select=config["select"]["policy"],
        seed=config["seed"],
        keyframe_distance=config["keyframe_distance"],
    )
