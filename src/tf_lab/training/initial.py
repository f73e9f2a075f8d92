"""What a training starts from (``init``): the weights of a checkpoint, or the state of a training.

Weights (``model.safetensors``) are trained on from step 0, by an optimiser that knows nothing yet:
fine-tuning. A state (``last.ckpt``) has the optimiser's moments and the step, too: the training
goes on where that one stood, up to ``optimizer.steps``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file
from torch import Tensor

from tf_lab.config.build import build_network, initialise_encoder
from tf_lab.config.schema import TrainConfig
from tf_lab.data.sources.settings import Content
from tf_lab.errors import TFLabError
from tf_lab.network.checkpoint import (
    checkpoint_file,
    load_network,
    our_encoder,
    shipped_checkpoint,
)
from tf_lab.network.encoders import ENCODERS
from tf_lab.network.encoders.settings import EncoderSettings
from tf_lab.network.encoders.weights import (
    ROOMS,
    SHIPPED,
    load_encoder,
    read_encoder,
    weights_file,
)
from tf_lab.network.network import Network
from tf_lab.network.settings import NetworkConfig
from tf_lab.training.state import read_state

SHIPPED_SETTINGS = "encoder=efficientnet_lite0 inputs=stereo"  # that it was trained with
# inputs that say nothing before they are trained: weights without them are trained on with them
ADDED = {"matching": "agreement.", "stereo": "stereo_evidence."}
OPTIMIZER = "optimizer"  # among the hyperparameters of a state


def make_network(config: TrainConfig) -> Network:
    """The network, initialised as ``init`` says, or its encoder as ``encoder.weights`` does."""
    network = build_network(config)
    start = initial_path(config)
    if start is not None:
        initialise(network, start)
        if config.init_encoder is not None:
            load_encoder(network.encoder, Path(config.init_encoder))
    else:
        initialise_encoder(network.encoder, config.encoder, config.model.name)
    return network


def initial_path(config: TrainConfig) -> Path | None:
    """The file that ``init`` names, if it names one; of a training's folder its weights.

    Raises:
        TFLabError: ``init_encoder`` is given without weights that it belongs to.
    """
    if not config.init:
        if config.init_encoder is not None:
            raise TFLabError(
                f"init_encoder={config.init_encoder}: takes the place of init's; without init= "
                "give encoder.weights="
            )
        return None
    path = shipped_checkpoint() if config.init == SHIPPED else Path(config.init)
    return checkpoint_file(path)


def with_initial_digests(config: TrainConfig, content: Content) -> Content:
    """With hashes of what is in the files that a training starts from.

    Raises:
        TFLabError: one cannot be read.
    """
    path = initial_path(config)
    if path is None:
        return with_encoder_digest(config.encoder, config.model.name, content)
    start = read_state(path) if _is_state(path) else _weights(path)
    content = replace(content, init=_digest(start))
    if config.init_encoder is None:
        return content
    if _is_state(path):
        raise TFLabError(
            f"init_encoder={config.init_encoder}: a state goes on as it is; to exchange its "
            "encoder give init=model.safetensors beside it"
        )
    return replace(content, encoder=_digest(read_encoder(Path(config.init_encoder))))


def with_encoder_digest(encoder: EncoderSettings, model: str, content: Content) -> Content:
    """With a hash of what is in the file that an encoder's weights come from, if they do.

    Ours ("rooms", "shipped") are another file in another version of tf_lab; what others published
    stays.

    Raises:
        TFLabError: it cannot be read.
    """
    file = weights_file(encoder.weights, ENCODERS[encoder.name].load())
    if encoder.weights in (ROOMS, SHIPPED) and (ours := our_encoder(encoder, model)).is_file():
        file = ours
    return content if file is None else replace(content, encoder=_digest(read_encoder(file)))


def initial_state(config: TrainConfig) -> Path | None:
    """The state that a training goes on from, if ``init`` names one."""
    path = initial_path(config)
    return path if path is not None and _is_state(path) else None


def initialise(network: Network, path: Path) -> None:
    """Give a network the weights of a checkpoint; of a state, only check that it fits.

    Raises:
        TFLabError: it cannot be read, or is of another network; the first misfit is named.
    """
    if _is_state(path):
        theirs = NetworkConfig(**_hyper_parameters(path, read_state(path))["network"])
        state = None
    else:
        other, _ = load_network(path)
        new = [name for name in ADDED if not getattr(other.config, name)]
        theirs = replace(other.config, **{name: getattr(network.config, name) for name in new})
        state = other.state_dict() | _untrained(network, new)
    misfit = _misfit(_plain(asdict(theirs)), _plain(asdict(network.config)))
    if misfit:
        cure = "the settings that it was trained with (config.yaml beside it)"
        cure = SHIPPED_SETTINGS if path == shipped_checkpoint() else cure
        raise TFLabError(f"init={path}: of another network: {misfit}; give {cure}")
    if state is not None:
        network.load_state_dict(state)


def _untrained(network: Network, inputs: Sequence[str]) -> dict[str, Tensor]:
    """The weights that a network has for some of the inputs in `ADDED`."""
    begin = tuple(ADDED[name] for name in inputs)
    return {k: v for k, v in network.state_dict().items() if k.startswith(begin)}


def check_state(path: Path, settings: Mapping[str, Any]) -> None:
    """That a training of these optimiser settings may go on from a state.

    Raises:
        TFLabError: it has all its steps already, or an optimiser of other settings.
    """
    state = read_state(path)
    theirs = _hyper_parameters(path, state).get(OPTIMIZER)
    if theirs is None:
        raise TFLabError(f"init={path}: does not say how it was trained; train it again")
    steps = settings["steps"]
    if state["global_step"] >= steps:
        done = state["global_step"]
        cure = "give more, or model.safetensors beside it to test or train on with its weights"
        raise TFLabError(f"init={path}: is at step {done} of optimizer.steps={steps}; {cure}")
    misfit = _misfit({**_plain(theirs), "steps": steps}, _plain(settings))
    if misfit:
        raise TFLabError(
            f"init={path}: a state goes on with its optimizer, of which {misfit}; to train its "
            "weights otherwise give model.safetensors beside it"
        )


def _hyper_parameters(path: Path, state: Mapping[str, Any]) -> dict[str, Any]:
    found = state.get("hyper_parameters")
    if not isinstance(found, dict) or not isinstance(found.get("network"), dict):
        raise TFLabError(f"init={path}: no state of `python -m tf_lab.train`")
    return found


def _is_state(path: Path) -> bool:
    return path.suffix == ".ckpt"


def _weights(path: Path) -> dict[str, Tensor]:
    load_network(path)  # says what is wrong with it
    return load_file(path)


def _digest(state: Mapping[str, Any]) -> str:
    """A hash of the tensors and the step in it, whatever else it says."""
    digest = hashlib.sha256()
    for name, value in _leaves(state):
        if isinstance(value, Tensor):
            digest.update(f"{name} {value.dtype} {list(value.shape)}\0".encode())
            digest.update(value.detach().contiguous().flatten().view(torch.uint8).numpy().tobytes())
        elif name == ".global_step":
            digest.update(f"{name} {value}\0".encode())
    return digest.hexdigest()[:16]


def _leaves(state: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    items = state.items() if isinstance(state, Mapping) else enumerate(state)
    for key, value in sorted((str(k), v) for k, v in items):
        if isinstance(value, Mapping | list):
            yield from _leaves(value, f"{name}.{key}")
        else:
            yield f"{name}.{key}", value


def _plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    """With lists for tuples."""
    return json.loads(json.dumps(settings))


def _misfit(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> str:
    """The first setting in which they differ, in words; nothing if there is none."""
    for name, value in ours.items():
        other = theirs.get(name, value)  # one that an older version did not have
        if isinstance(value, dict):
            if inner := _misfit(other, value):
                return f"{name}.{inner}"
        elif other != value:
            return f"{name} is {other} there and {value} here"
    return ""
