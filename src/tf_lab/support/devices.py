"""Devices by name."""

from __future__ import annotations

import torch

from tf_lab.errors import TFLabError
from tf_lab.support.words import counted


def is_there(name: str) -> bool:
    """Whether torch sees a device of a name such as "cuda:1"."""
    device = torch.device(name)
    return device.type != "cuda" or (device.index or 0) < torch.cuda.device_count()


def device_of(name: str, setting: str = "device") -> torch.device:
    """The device called "auto" (CUDA where there is one), "cpu", "cuda" or "cuda:1".

    Raises:
        TFLabError: it is not there; the message names the ``setting``.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        device = torch.device("meta")
    if device.type not in ("cpu", "cuda"):
        raise TFLabError(f"{setting}={name}: choose auto, cpu or cuda")
    if not is_there(name):
        there = counted(torch.cuda.device_count(), "CUDA device")
        raise TFLabError(f"{setting}={name}: torch sees {there}; use {setting}=cpu")
    return device
