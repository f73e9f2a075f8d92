"""A trained network in one file: safetensors, with its configuration in the header."""

from __future__ import annotations

import json
import logging
import textwrap
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from tf_lab.errors import TFLabError
from tf_lab.network.encoders.settings import EncoderSettings
from tf_lab.network.encoders.weights import SHIPPED
from tf_lab.network.finite import check_finite
from tf_lab.network.network import Network
from tf_lab.network.settings import NetworkConfig
from tf_lab.stereo.depth import stereo_identity
from tf_lab.support.documents import parse_json
from tf_lab.support.files import atomic_path
from tf_lab.support.headers import read_header
from tf_lab.support.layout import WEIGHTS
from tf_lab.support.records import record

log = logging.getLogger(__name__)
FOLDER = Path(__file__).resolve().parents[1] / "weights"


def save_network(network: Network, path: Path, info: dict[str, Any]) -> None:
    """Write weights and configuration; ``info`` (provenance) goes into the header too."""
    state = {k: v.detach().cpu().contiguous() for k, v in network.state_dict().items()}
    metadata = {"config": json.dumps(asdict(network.config)), "info": json.dumps(info)}
    with atomic_path(path) as temporary:
        save_file(state, temporary, metadata)


def checkpoint_file(path: str | Path) -> Path:
    """The checkpoint of a training's folder; any other path is one itself."""
    path = Path(path).expanduser()
    return path / WEIGHTS if path.is_dir() else path


def load_network(path: str | Path) -> tuple[Network, dict[str, Any]]:
    """The network of a checkpoint, in evaluation mode on the CPU, and its provenance.

    Args:
        path: of the file, or of the folder of the training that wrote it.

    Raises:
        TFLabError: the file is missing, not a checkpoint, of another network, or not finite.
    """
    path = checkpoint_file(path)
    if not path.is_file():
        raise TFLabError(f"{path}: no such checkpoint; train one with `python -m tf_lab.train`")
    metadata = read_header(path)
    if "config" not in metadata:
        raise TFLabError(
            f"{path}: no network configuration inside; it is not a checkpoint of tf_lab"
        )
    try:
        network = Network(_config_for(path, metadata["config"]))
        network.load_state_dict(load_file(path))
        info = record(dict[str, Any], parse_json(metadata.get("info", "{}")))
    except (TFLabError, TypeError, KeyError, ValueError, RuntimeError) as error:
        reason = textwrap.shorten(str(error), 160)
        raise TFLabError(
            f"{path}: made by another version or another network ({reason}); train it again"
        ) from error
    check_finite(network.state_dict(), path)
    if network.config.stereo and _stereo_of(info) not in (None, stereo_identity()):
        log.warning(
            "%s: trained with depth by another stereo than there is now; train it on from its "
            "weights (init=)",
            path,
        )
    return network.eval(), info


def _stereo_of(info: dict[str, Any]) -> str | None:
    """The identity of the stereo that a network was trained with; None if nothing is said."""
    try:
        return str(info["training"]["config"]["content"].get("stereo"))
    except (AttributeError, KeyError, TypeError):
        return None


def _config_for(path: Path, text: str) -> NetworkConfig:
    """The configuration of a checkpoint, whose tensors are of its sizes; nothing large is made.

    Raises:
        ValueError, TFLabError: it is none, or the tensors are others.
    """
    found = record(dict[str, Any], parse_json(text))
    if unknown := sorted(found.keys() - {field.name for field in fields(NetworkConfig)}):
        raise ValueError(f"{unknown[0]} is no setting of a network")
    config = record(NetworkConfig, found)
    with torch.device("meta"):
        wanted = {name: [*tensor.shape] for name, tensor in Network(config).state_dict().items()}
    with safe_open(path, framework="pt") as file:
        there = {name: file.get_slice(name).get_shape() for name in file.keys()}  # noqa: SIM118
    if misfit := next((n for n in {**wanted, **there} if wanted.get(n) != there.get(n)), None):
        shape, expected = there.get(misfit, "no shape"), wanted.get(misfit, "no such tensor")
        raise ValueError(f"{misfit} has {shape}, expected {expected}")
    return config


def shipped_checkpoint() -> Path:
    """The checkpoint that comes with the package."""
    return FOLDER / "tiny.safetensors"


def our_encoder(encoder: EncoderSettings, model: str) -> Path:
    """The file in the package that has our weights of an encoder, if they come with it.

    The checkpoint's ("shipped"), or pre-trained ("rooms"): a ResNet's by the model, which gives it
    its size; of any other encoder there is one file, with maps of the width of ``model=tiny``.
    """
    if encoder.weights == SHIPPED:
        return shipped_checkpoint()
    return FOLDER / f"{model if encoder.name == 'resnet' else encoder.name}-encoder.safetensors"
