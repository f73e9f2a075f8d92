"""Devices by name."""

from __future__ import annotations

import re
from pathlib import Path

import torch

from tf_lab.errors import TFLabError
from tf_lab.support.memory import total_memory
from tf_lab.support.words import counted


def is_there(name: str) -> bool:
    """Whether torch sees a device of a name such as "cuda:1"."""
    device = torch.device(name)
    return device.type != "cuda" or (device.index or 0) < torch.cuda.device_count()


def use_tensor_cores() -> None:
    """Have GPUs multiply matrices in TF32, much faster than in float32."""
    torch.set_float32_matmul_precision("high")


def accelerator_of(name: str) -> str:
    """What Lightning is to train on for ``trainer.accelerator``: CUDA where there is one, or a CPU.

    Its own "auto" takes Apple's GPUs, too, which have no float64 to select views by.

    Raises:
        TFLabError: it is a GPU, and torch sees none.
    """
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name in ("gpu", "cuda") and not torch.cuda.is_available():
        raise TFLabError(
            f"trainer.accelerator={name}: torch sees no CUDA GPU here; leave trainer=gpu out (one "
            "that is there is used), or install a torch that has CUDA"
        )
    return "cuda" if name == "gpu" else name


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


def free_memory(device: torch.device) -> int:
    """Bytes that may still be taken on a GPU, or of this machine's memory."""
    if device.type == "cuda" and torch.cuda.is_available():
        cached = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
        return int(torch.cuda.mem_get_info(device)[0]) + cached
    info = Path("/proc/meminfo")  # of Linux; elsewhere what there is in all
    found = re.search(r"MemAvailable:\s*(\d+) kB", info.read_text()) if info.exists() else None
    return 1024 * int(found[1]) if found else total_memory()
