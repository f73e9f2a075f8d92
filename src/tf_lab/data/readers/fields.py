"""Numbers in the json documents of sources, checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tf_lab.errors import TFLabError
from tf_lab.support.documents import read_json


def read_document(path: Path, cure: str) -> dict[str, Any]:
    """A json file that holds an object.

    Raises:
        TFLabError: it is missing, or something else.
    """
    document = read_json(path, cure)
    if not isinstance(document, dict):
        raise TFLabError(f"{path}: no json object; {cure}")
    return document


def number(document: Mapping[str, Any], key: str, default: float | None = None) -> float:
    """A finite number. Raises ValueError: it is missing, or something else."""
    value = document.get(key, default)
    try:
        found = math.nan if isinstance(value, (bool, str)) else float(value)
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not math.isfinite(found):
        raise ValueError(f"{key} is {str(value)[:40]!r}, not a number")
    return found


def numbers(document: Mapping[str, Any], key: str, *counts: int) -> np.ndarray:
    """A list, nested or not, of so many numbers as float64 [N]; NaN and infinity are some.

    Raises:
        ValueError: it is missing, or something else.
    """
    try:
        found = np.array(document.get(key), np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        found = np.empty(0)
    if len(found) not in counts:
        raise ValueError(f"its {key} is not {' or '.join(map(str, counts))} numbers")
    return found
