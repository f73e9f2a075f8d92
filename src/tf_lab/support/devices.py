"""Devices by name."""

from __future__ import annotations

import torch

from tf_lab.errors import TFLabError


def device_of(name: str) -> torch.device:
    """The device called "auto" (CUDA where there is one), "cpu" or "cuda".

    Raises:
        TFLabError: it is not there.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name == "cuda" and not torch.cuda.is_available():
        raise TFLabError("device=cuda: torch sees no CUDA device; use device=cpu")
    try:
        return torch.device(name)
    except RuntimeError:
        raise TFLabError(f"device={name}: choose auto, cpu or cuda") from None
