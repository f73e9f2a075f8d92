"""What numbers networks compute in."""

from __future__ import annotations

import torch


def dtype_of(precision: str, device: torch.device) -> torch.dtype:
    """The dtype called so; "auto": bfloat16 on a GPU, else float32."""
    if precision == "auto":
        precision = "bfloat16" if device.type == "cuda" else "float32"
    return getattr(torch, precision)
