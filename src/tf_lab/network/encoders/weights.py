"""Weights that an encoder starts from."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from tf_lab.errors import TFLabError


def read_state_dict(path: Path) -> dict[str, Tensor]:
    """Tensors of a .safetensors file or of a weights-only torch file.

    Raises:
        TFLabError: the file is missing or is neither.
    """
    from safetensors.torch import load_file

    if not path.is_file():
        raise TFLabError(f"{path}: no such weights file")
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # both loaders raise many kinds
        raise TFLabError(f"{path}: not a weights file ({type(error).__name__})") from error
    if not isinstance(state, dict) or not all(isinstance(v, Tensor) for v in state.values()):
        raise TFLabError(f"{path}: not a weights file (it holds no dictionary of tensors)")
    return state
