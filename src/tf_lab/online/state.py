"""A reconstruction in one file: frames and view sets; all else is computed from them again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.network.encoders import ENCODERS
from tf_lab.network.network import Network
from tf_lab.network.settings import NetworkConfig
from tf_lab.online.frames import Frames, check_camera
from tf_lab.online.lattice.blocks import HALF
from tf_lab.online.lattice.level import Level
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.stereo.depth import stereo_identity
from tf_lab.support.documents import parse_json
from tf_lab.support.files import atomic_path
from tf_lab.support.records import record
from tf_lab.support.settings import absent_values

FORMAT = 2
COLUMNS = ("frames", "logits", "seen")


@dataclass(frozen=True)
class Description:
    """What the header of a saved reconstruction says."""

    format: int
    settings: ReconstructionSettings
    network: str


def write_state(
    path: Path, settings: ReconstructionSettings, frames: Frames, levels: Sequence[Level]
) -> None:
    """Write a reconstruction as safetensors, whole or not at all; the network is not part of it."""
    description = Description(FORMAT, settings, fingerprint(frames.network))
    tensors: dict[str, Tensor] = {}
    if len(frames):
        tensors["images"] = torch.stack(frames.images)
        for name in ("K", "world_T_cam"):
            tensors[name] = frames.cameras[name]
    for level in levels:
        tensors[f"{level.name}.blocks"] = level.blocks.coords
        for name in COLUMNS:
            tensors[f"{level.name}.{name}"] = level.store.table[name]
    state = {name: tensor.cpu().contiguous() for name, tensor in tensors.items()}
    with atomic_path(path) as temporary:
        save_file(state, temporary, {"reconstruction": json.dumps(asdict(description))})


def read_state(path: Path, network: Network) -> tuple[ReconstructionSettings, dict[str, Tensor]]:
    """The settings of what `write_state` wrote with this network, and its tensors for `restore`.

    Raises:
        TFLabError: the file is missing, damaged, or made with another network.
    """
    if not path.is_file():
        raise TFLabError(f"{path}: no such reconstruction")
    try:
        with safe_open(path, framework="pt") as file:
            saved = record(Description, parse_json((file.metadata() or {})["reconstruction"]))
            if saved.format != FORMAT:
                raise TFLabError(f"{path}: of another version of tf_lab; reconstruct again")
            if saved.network != fingerprint(network):
                raise TFLabError(
                    f"{path}: made with another network, or with other stereo; load it with that "
                    "one's checkpoint, or reconstruct again"
                )
            return saved.settings, {
                name: file.get_tensor(name)
                for name in file.keys()  # noqa: SIM118
            }
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise TFLabError(f"{path}: not a saved reconstruction ({error})") from error


def restore(
    path: Path, tensors: Mapping[str, Tensor], frames: Frames, levels: Sequence[Level]
) -> None:
    """Fill an empty reconstruction with what `read_state` read.

    Raises:
        TFLabError: something is missing.
    """
    try:
        if "images" in tensors:
            cameras = tensors["images"], tensors["K"], tensors["world_T_cam"]
            for image, K, pose in zip(*cameras, strict=True):
                if image.dtype != torch.uint8 or image.shape[0] != 3 or image.ndim != 3:
                    raise ValueError(f"an image of {image.dtype} {list(image.shape)}")
                check_camera(K, pose, (image.shape[2], image.shape[1]))
                frames.add(image, K.float(), pose.float(), encode=False)
        for level in levels:
            _restore(level, tensors, len(frames))
    except (TFLabError, KeyError, ValueError, RuntimeError) as error:
        raise TFLabError(f"{path}: damaged ({error}); reconstruct again") from error


def _restore(level: Level, tensors: Mapping[str, Tensor], frames: int) -> None:
    """View sets by the numbers that blocks had; everything made of them is out of date."""
    coords = tensors[f"{level.name}.blocks"].to(level.device)
    if coords.dtype != torch.int64 or coords.shape[1:] != (3,) or (coords.abs() >= HALF).any():
        raise ValueError(f"{level.name}.blocks are no coordinates")
    level.allocate(coords)
    rows = level.blocks.rows_in(level.blocks.find(coords))  # blocks may be numbered otherwise now
    for name in COLUMNS:
        column, values = level.store.table[name], tensors[f"{level.name}.{name}"]
        if values.dtype != column.dtype or values.shape != (len(rows), *column.shape[1:]):
            raise ValueError(f"{level.name}.{name} is {values.dtype} {list(values.shape)}")
        column[rows] = values.to(level.device)
    held = level.store.frames
    if held.numel() and not (held.min() >= -1 and held.max() < frames):
        raise ValueError(f"{level.name}.frames names a frame that is not there")
    level.store.dirty[:] = level.store.seen > 0


def _described(config: NetworkConfig) -> str:
    """Its settings, without those that came later and mean what was before."""
    kind = ENCODERS[config.encoder.get("name", "resnet")].settings
    values = {field.name: getattr(config, field.name) for field in fields(config)}
    values["encoder"] = _without(config.encoder, absent_values(kind))
    said = [f"{k}={v!r}" for k, v in _without(values, absent_values(type(config))).items()]
    return f"{type(config).__name__}({', '.join(said)})"


def _without(values: Mapping[str, Any], absent: Mapping[str, Any]) -> dict[str, Any]:
    return {k: value for k, value in values.items() if k not in absent or value != absent[k]}


def fingerprint(network: Network) -> str:
    """Tells networks with other weights apart."""
    digest = hashlib.sha256(_described(network.config).encode())
    if network.config.stereo:  # depth is not saved, and has to be found again
        digest.update(stereo_identity().encode())
    for name, tensor in sorted(network.state_dict().items()):
        digest.update(name.encode())
        digest.update(tensor.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy())
    return digest.hexdigest()[:32]
