"""Weights that are numbers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from tf_lab.errors import TFLabError


def not_finite(state: Mapping[str, Any]) -> list[str]:
    """The names of the tensors of a state dict that have a NaN or an infinity in them."""
    floats = {k: v for k, v in state.items() if isinstance(v, Tensor) and v.is_floating_point()}
    return [name for name, value in floats.items() if not bool(value.isfinite().all())]


def check_finite(state: Mapping[str, Any], path: Path) -> None:
    """That no tensor of a state dict has a NaN or an infinity in it.

    Raises:
        TFLabError: one has; it is named, and the file.
    """
    if wrong := not_finite(state):
        raise TFLabError(
            f"{path}: {len(wrong)} of {len(state)} tensors are not finite (first: {wrong[0]}); the "
            "training that made them went wrong"
        )
