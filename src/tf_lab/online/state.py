"""A reconstruction in one file: frames and view sets; all else is computed from them again."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.network.network import Network
from tf_lab.online.lattice.level import Level
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.support.files import atomic_path

FORMAT = 2
COLUMNS = ("frames", "logits", "seen")


def save_reconstruction(reconstructor: Reconstructor, path: Path) -> None:
    """Write a reconstruction as safetensors, whole or not at all; the network is not part of it."""
    r = reconstructor
    metadata = {
        "format": FORMAT,
        "settings": asdict(r.settings),
        "network": fingerprint(r.network),
    }
    tensors: dict[str, Tensor] = {}
    if len(r.frames):
        tensors["images"] = torch.stack(r.frames.images)
        for name in ("K", "world_T_cam"):
            tensors[name] = r.frames.cameras[name]
    for level in (r.coarse, r.fine):
        tensors[f"{level.name}.blocks"] = level.blocks.coords
        for name in COLUMNS:
            tensors[f"{level.name}.{name}"] = level.store.table[name]
    state = {name: tensor.cpu().contiguous().clone() for name, tensor in tensors.items()}
    with atomic_path(path) as temporary:
        save_file(state, temporary, {"reconstruction": json.dumps(metadata)})


def load_reconstruction(path: Path, network: Network) -> Reconstructor:
    """Go on with a saved reconstruction.

    Args:
        path: what `save_reconstruction` wrote.
        network: the one that it was made with, on its device, in evaluation mode.

    Raises:
        TFLabError: the file is missing, damaged, or made with another network.
    """
    metadata, tensors = _read(path)
    if metadata["network"] != fingerprint(network):
        raise TFLabError(f"{path}: made with another network; load it with that one's checkpoint")
    try:
        settings = ReconstructionSettings(**metadata["settings"])
        r = Reconstructor(network, settings)
        with torch.inference_mode():
            if "images" in tensors:
                cameras = tensors["images"], tensors["K"], tensors["world_T_cam"]
                for image, K, pose in zip(*cameras, strict=True):
                    r.frames.add(image, K, pose, encode=False)
            for level in (r.coarse, r.fine):
                _restore(level, tensors)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise TFLabError(f"{path}: damaged ({error}); reconstruct again") from error
    return r


def _restore(level: Level, tensors: dict[str, Tensor]) -> None:
    """View sets by the numbers that blocks had; everything made of them is out of date."""
    coords = tensors[f"{level.name}.blocks"].to(level.device)
    level.allocate(coords)
    rows = level.blocks.rows_in(level.blocks.find(coords))  # blocks may be numbered otherwise now
    for name in COLUMNS:
        level.store.table[name][rows] = tensors[f"{level.name}.{name}"].to(level.device)
    level.store.dirty[:] = level.store.seen > 0


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    if not path.is_file():
        raise TFLabError(f"{path}: no such reconstruction")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = json.loads((file.metadata() or {})["reconstruction"])
            if metadata["format"] != FORMAT:
                raise TFLabError(f"{path}: of another version of tf_lab; reconstruct again")
            return metadata, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise TFLabError(f"{path}: not a saved reconstruction ({error})") from error


def fingerprint(network: Network) -> str:
    """Tells networks with other weights apart."""
    digest = hashlib.sha256(repr(network.config).encode())
    for name, tensor in sorted(network.state_dict().items()):
        digest.update(name.encode())
        digest.update(tensor.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy())
    return digest.hexdigest()[:32]
