"""The state of a training (``last.ckpt``): all that it needs to go on as if nothing had been."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from tf_lab.errors import TFLabError
from tf_lab.network.finite import check_finite

PARTS = {  # of what Lightning saves, those without which it cannot go on
    "state_dict": dict,
    "optimizer_states": list,
    "lr_schedulers": list,
    "loops": dict,
    "callbacks": dict,
    "epoch": int,
    "global_step": int,
    "pytorch-lightning_version": str,
}


def read_state(path: Path) -> dict[str, Any]:
    """The state of a training.

    Raises:
        TFLabError: it is missing, damaged, something else, or its weights are not finite.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise TFLabError(f"{path}: no such file; give last.ckpt of a training") from error
    except Exception as error:  # any damage
        raise TFLabError(
            f"{path}: damaged, or no state of a training ({type(error).__name__})"
        ) from error
    if not isinstance(state, dict):
        raise TFLabError(f"{path}: no state of a training, but a {type(state).__name__}")
    for name, kind in PARTS.items():
        if not isinstance(state.get(name), kind):
            raise TFLabError(f"{path}: damaged, or no state of a training (no {name} in it)")
    check_finite(state["state_dict"], path)
    return state
