"""From the typed config to the objects it describes."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import torch

from tf_lab.config.groups import OnlineSettings
from tf_lab.config.schema import CaptureConfig, NetworkSettings, TrainConfig
from tf_lab.evaluation.registry import METRICS
from tf_lab.network.checkpoint import our_encoder
from tf_lab.network.encoders.pyramid import Encoder
from tf_lab.network.encoders.settings import EncoderSettings
from tf_lab.network.encoders.weights import load_encoder_weights
from tf_lab.network.network import Network
from tf_lab.network.settings import NetworkConfig
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.online.views import make_policy
from tf_lab.support.devices import device_of, use_tensor_cores
from tf_lab.support.memory import check_memory

TRAINED_BYTES = 16  # a weight, its gradient and Adam's two moments


def build_network(config: NetworkSettings) -> Network:
    """The network with random weights.

    Raises:
        TFLabError: it cannot be.
    """
    sizes = {name: value for name, value in asdict(config.model).items() if name != "name"}
    return Network(
        NetworkConfig(
            **sizes,
            **asdict(config.inputs),
            encoder=config.encoder.architecture(),
            fusion=asdict(config.fusion),
            refine=config.refine,
            filter=config.filter,
        )
    )


def check_network(config: NetworkSettings) -> None:
    """That the network of a config can be made and trained; nothing large is made.

    Raises:
        TFLabError: it cannot be, or takes more memory than there is.
    """
    with torch.device("meta"):
        weights = sum(weight.numel() for weight in build_network(config).parameters())
    model = config.model
    check_memory(
        f"model.width={model.width} model.blocks={model.blocks}: to train the network",
        TRAINED_BYTES * weights,
        "give smaller ones",
    )


def check_test(config: TrainConfig) -> None:
    """That what a test is made with can be: the policy of view selection, the metrics.

    Raises:
        TFLabError: it cannot be imported or made.
    """
    make_policy(config.select, config.seed)
    for metric in config.metrics.values():
        METRICS.named(metric).load()


def initialise_encoder(encoder: Encoder, settings: EncoderSettings, model: str) -> None:
    """Load the weights that ``encoder.weights`` means for a model of this name."""
    load_encoder_weights(encoder, settings.weights, our_encoder(settings, model))


def reconstruction_settings(
    online: OnlineSettings, resolution: float, **others: Any
) -> ReconstructionSettings:
    """Mesh resolution (metres) and what the group ``online`` says; ``others`` as they are.

    Raises:
        TFLabError: a value that cannot be, or a device that is not there.
    """
    budget, device = online.maps_budget, online.maps_device
    return ReconstructionSettings(
        resolution=resolution,
        batch=online.batch,
        precision=online.precision,
        maps=online.precision,
        maps_device=None if device == "auto" else str(device_of(device, "online.maps_device")),
        maps_budget=None if budget is None else round(budget * 2.0**30),
        **others,
    )


def capture_settings(config: TrainConfig | CaptureConfig) -> ReconstructionSettings:
    """How captures are reconstructed at test time."""
    return reconstruction_settings(
        config.online,
        config.resolution,
        views=config.views,
        threshold=config.threshold,
        select=config.select,
        seed=config.seed,
        keyframe_distance=config.keyframe_distance,
    )


def ready(network: Network, online: OnlineSettings, device: torch.device) -> Network:
    """A network on the device that it reconstructs on, compiled if ``online.compile`` says so."""
    use_tensor_cores()  # as when it was trained
    if online.compile:
        network.compile_parts()
    return network.to(device)
