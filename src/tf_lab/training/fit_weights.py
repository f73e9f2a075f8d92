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
from safetensors.torch import load_file, save_file
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
    alone = replace(one_device(trainer), devices=trainer.devices[:1] if named else 1)

    def scores() -> dict[str, float]:  # of the weights as they are now
        return _scores(score(module, data, alone), sets)

    def reuse() -> bool:
        if not output.exists():
            return False
        found = _scores_of(output, identity)
        print(f"reusing the identical finished {output}", flush=True)
        if {name.partition("/")[0] for name in found} < set(sets):  # it was made without one
            network.load_state_dict(load_file(output))
            found = scores()
        print(found)
        return True

    if settings.steps == 0 and finish is None:
        print(scores())
        return
    if reuse():
        return
    directory = output.with_name(f"{output.stem}-{identity}")
    with rank_zero_lock(directory, "pre-training") if settings.steps else nullcontext():
        if reuse():  # what another process made, meanwhile
            return
        if settings.steps > 0:
            loggers = [CSVLogger(directory, name="logs")]
            fit(module, data, directory, alone, settings, loggers=loggers)
        found = scores()
        if finish is not None:
            finish()
        if output.exists():  # another training has made it: this one's state stays
            _scores_of(output, identity)
        _write(network, output, {**info, "identity": identity, "scores": found})
        (directory / LAST).unlink(missing_ok=True)


def one_device(trainer: TrainerSettings) -> TrainerSettings:
    """The settings with the one device that is used, whatever is asked for."""
    return replace(trainer, devices=1, strategy="auto")


def _scores_of(output: Path, identity: str) -> dict[str, float]:
    """The scores of the file, which is of this identity.

    Raises:
        TFLabError: it is of another.
    """
    cure = f"give another output=, or delete it: rm {shlex.quote(str(output))}"
    try:
        info = read_info(output)
    except TFLabError as error:
        raise TFLabError(f"{output}: there already, and no such weights; {cure}") from error
    if info.get("identity") != identity:
        raise TFLabError(f"{output}: there already, of other settings or data; {cure}")
    return dict(info["scores"])


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
