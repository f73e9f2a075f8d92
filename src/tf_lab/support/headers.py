"""What the header of a safetensors file says, without its tensors (and without torch)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open

from tf_lab.errors import TFLabError
from tf_lab.support.documents import parse_json
from tf_lab.support.layout import WEIGHTS
from tf_lab.support.records import record


def read_header(path: Path) -> dict[str, str]:
    """The texts that a checkpoint was saved with, by name.

    Raises:
        TFLabError: the file is not a checkpoint, or cannot be read.
    """
    try:
        with safe_open(path, framework="np") as file:
            return file.metadata() or {}
    except OSError as error:
        raise TFLabError(f"{path}: cannot be read ({error.strerror or error})") from error
    except SafetensorError as error:
        raise TFLabError(
            f"{path}: damaged, or not a checkpoint of tf_lab; expected {WEIGHTS} of a training run"
        ) from error


def read_info(path: Path) -> dict[str, Any]:
    """The provenance of a checkpoint, without its weights.

    Raises:
        TFLabError: the file is not a checkpoint, or its provenance is damaged.
    """
    try:
        return record(dict[str, Any], parse_json(read_header(path).get("info", "{}")))
    except ValueError as error:
        raise TFLabError(f"{path}: its provenance is {error}; train it again") from error
