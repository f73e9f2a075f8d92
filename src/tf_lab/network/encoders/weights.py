"""Weights that an encoder starts from."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.network.encoders.pyramid import PYRAMID, Encoder
from tf_lab.network.finite import check_finite

# words of every kind of encoder, beside its `PUBLISHED`
RANDOM, ROOMS, SHIPPED = "none", "rooms", "shipped"
IN_NETWORK = "encoder."  # begins the names of its tensors in a checkpoint
MOST_SHARED = 16  # tensors may share what is stored


def read_state_dict(path: Path) -> dict[str, Tensor]:
    """Tensors of a .safetensors file or of a weights-only torch file.

    Raises:
        TFLabError: the file is missing, is neither, or its weights are not finite.
    """
    from safetensors.torch import load_file

    if not path.is_file():
        raise TFLabError(f"{path}: no such weights file")
    try:
        safe = path.suffix == ".safetensors"
        state = load_file(path) if safe else torch.load(path, "cpu", weights_only=True)
    except Exception as error:  # both loaders raise many kinds
        raise TFLabError(f"{path}: not a weights file ({type(error).__name__})") from error
    if not isinstance(state, dict) or not all(isinstance(v, Tensor) for v in state.values()):
        raise TFLabError(f"{path}: not a weights file (it holds no dictionary of tensors)")
    size = sum(tensor.numel() * tensor.element_size() for tensor in state.values())
    if size > MOST_SHARED * path.stat().st_size:  # views that repeat a number
        raise TFLabError(f"{path}: not a weights file (its tensors are larger than it)")
    check_finite(state, path)
    return state


def read_encoder(path: Path) -> dict[str, Tensor]:
    """Of a checkpoint the tensors of its encoder, of any other weights file all.

    Raises:
        TFLabError: as `read_state_dict`.
    """
    state = read_state_dict(path)
    own = {k.removeprefix(IN_NETWORK): v for k, v in state.items() if k.startswith(IN_NETWORK)}
    return own or state


def packaged_weights(word: str, package: str, file: str, install: str) -> dict[str, Tensor]:
    """Those that a Python package carries, which is not imported.

    Args:
        word: that ``encoder.weights`` has for them.
        package: as it is imported.
        file: in its folder.
        install: the command that installs it.

    Raises:
        TFLabError: it is not installed.
    """
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None:
        raise TFLabError(
            f"encoder.weights={word}: {package} is not installed; "
            f"`{install}`, or use encoder.weights=none"
        )
    return read_state_dict(Path(spec.origin).parent / file)


def weights_file(source: str, encoder: type[Encoder]) -> Path | None:
    """The file that ``encoder.weights`` names; None if it is a word of this kind of encoder.

    Raises:
        TFLabError: it is neither.
    """
    words = (RANDOM, ROOMS, SHIPPED, encoder.PUBLISHED)
    if source in words:
        return None
    if not Path(source).is_file():
        raise TFLabError(
            f"encoder.weights={source}: no such weights file; give one, or {RANDOM}, {ROOMS}, "
            f"{SHIPPED} or {encoder.PUBLISHED}, which this encoder knows"
        )
    return Path(source)


def load_encoder_weights(encoder: Encoder, source: str, ours: Path) -> None:
    """Initialise an encoder.

    Args:
        encoder: changed in place.
        source: "none" (random), the encoder's word for what others published (`PUBLISHED`), "rooms"
            (ours, pre-trained on the rooms' train split), "shipped" (that of the checkpoint that
            comes with the package), or a path to a state dict (.pth with the keys of the published
            weights, or .safetensors) or to a checkpoint.
        ours: the file behind "rooms" for this model size, or behind "shipped".

    Raises:
        TFLabError: no weights can be had, or they are of another architecture.
    """
    if source == RANDOM:
        return
    file = weights_file(source, type(encoder))
    if file is not None:
        state = read_encoder(file)
    elif source == encoder.PUBLISHED:
        state = encoder.published_weights()
    else:
        if not ours.is_file():
            model, _, kind = ours.stem.removesuffix("-encoder").partition("-")
            words = f"model={model} encoder={kind}" if kind else f"model={model}"
            raise TFLabError(
                f"encoder.weights=rooms: {ours.name} does not ship with tf_lab; make it with "
                f"`python -m tf_lab.pretrain {words}` and give the file that it names "
                "(encoder.weights=FILE), or use encoder.weights=none"
            )
        state = read_encoder(ours)
    state = encoder.trunk_of(state)
    own = encoder.state_dict()
    cure = "use weights of the same encoder, or encoder.weights=none"
    if source == SHIPPED:
        cure = "the shipped one is of model=tiny encoder=efficientnet_lite0"
    unknown = [k for k, v in state.items() if k not in own or own[k].shape != v.shape]
    if unknown:
        raise TFLabError(
            f"encoder.weights={source}: {len(unknown)} tensors do not fit this encoder "
            f"(first: {unknown[0]}); {cure}"
        )
    missing = [k for k in own if k not in state and not k.startswith(PYRAMID)]  # which is ours
    missing = [k for k in missing if not k.endswith("num_batches_tracked")]
    if missing:
        raise TFLabError(
            f"encoder.weights={source}: {len(missing)} tensors of this encoder are missing "
            f"(first: {missing[0]}); {cure}"
        )
    encoder.load_state_dict(state, strict=False)


def load_encoder(encoder: Encoder, file: Path) -> None:
    """Give an encoder all weights of a file that was made of the same, its pyramid's, too.

    Raises:
        TFLabError: it cannot be read, or is of another encoder.
    """
    state = read_encoder(file)
    own = encoder.state_dict()
    unlike = [k for k in sorted({*own, *state}) if _shape(own, k) != _shape(state, k)]
    if unlike:
        raise TFLabError(
            f"{file}: of another encoder: {len(unlike)} tensors do not fit (first: {unlike[0]}); "
            "give a file that `python -m tf_lab.pretrain` made of the same"
        )
    encoder.load_state_dict(state)


def _shape(state: Mapping[str, Tensor], name: str) -> torch.Size | None:
    return state[name].shape if name in state else None
