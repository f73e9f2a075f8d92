"""A network that is trained by itself, before the others, and kept as a file of weights."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import lightning as L
from lightning.pytorch.loggers import CSVLogger
from safetensors.torch import save_file
from torch import nn

from tf_lab.config.groups import TrainerSettings
from tf_lab.errors import TFLabError
from tf_lab.experiments.provenance import without_places
from tf_lab.support.files import atomic_path
from tf_lab.support.headers import read_info
from tf_lab.support.layout import LAST
from tf_lab.training.fit import FitSettings, fit, rank_zero_lock, score


def fit_weights(
    network: nn.Module,
    module: L.LightningModule,
    data: Callable[[], L.LightningDataModule],
    output: Path,
    trainer: TrainerSettings,
    settings: FitSettings,
    identity: str,
    sets: Sequence[str],
    info: dict[str, Any],
    finish: Callable[[], None] | None = None,
) -> None:
    """Train, and write weights, provenance and scores; of 0 steps print scores alone.

    What is there is never replaced: a finished file of the same identity is reused.

    Args:
        network: whose weights are written.
        module: what trains it, and logs scores named ``SET/SCORE``.
        data: what it is trained and validated on.
        output: the file; the state to go on from lies beside it meanwhile, in a folder of its name
            and the identity.
        trainer: one device is used.
        settings: see `fit`.
        identity: of all that shapes the weights.
        sets: names of what is validated on.
        info: what the file says of its making, beside the scores: provenance and config.
        finish: what is done to the trained network before it is written; of 0 steps it is written
            for this.

    Raises:
        TFLabError: the file is there, and of another identity; or as of `fit`.
    """
    named = isinstance(trainer.devices, list)  # which, not how many
    alone = replace(trainer, devices=trainer.devices[:1] if named else 1, strategy="auto")

    if settings.steps == 0 and finish is None:
        print(_scores(score(module, data, alone), sets))
        return
    if _is_made(output, identity):
        return
    directory = output.with_name(f"{output.stem}-{identity}")
    with rank_zero_lock(directory, "pre-training") if settings.steps else nullcontext():
        if _is_made(output, identity):  # by another process, meanwhile
            return
        if settings.steps > 0:
            loggers = [CSVLogger(directory, name="logs")]
            fit(module, data, directory, alone, settings, loggers=loggers)
        scores = _scores(score(module, data, alone), sets)
        if finish is not None:
            finish()
        _write(network, output, {**info, "identity": identity, "scores": scores})
        (directory / LAST).unlink(missing_ok=True)


def _is_made(output: Path, identity: str) -> bool:
    """Whether the weights are there already.

    Raises:
        TFLabError: others are.
    """
    if not output.exists():
        return False
    info = read_info(output)
    if info.get("identity") != identity:
        raise TFLabError(
            f"{output}: there already, of other settings or data; give another output=, or "
            f"delete it: rm {shlex.quote(str(output))}"
        )
    print(f"reusing the identical finished {output}: {info['scores']}")
    return True


def _write(network: nn.Module, output: Path, info: dict[str, Any]) -> None:
    with atomic_path(output) as temporary:
        save_file(network.state_dict(), temporary, {"info": json.dumps(without_places(info))})
    print(f"{output}: {info['scores']}")


def _scores(logged: Mapping[str, Any], sets: Sequence[str]) -> dict[str, float]:
    return {
        name: round(float(value), 4)
        for name, value in logged.items()
        if name.partition("/")[0] in sets
    }
