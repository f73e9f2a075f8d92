"""Where a training logs to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import wandb
from lightning.pytorch.loggers import CSVLogger, Logger, TensorBoardLogger, WandbLogger

from tf_lab.errors import TFLabError


def make_loggers(config: Mapping[str, Any], directory: Path) -> Sequence[Logger]:
    """The CSV logger, which the loss curve is drawn from, and the one that is asked for.

    Raises:
        TFLabError: its package or its account is missing.
    """
    kind = config["logger"]["kind"]
    loggers: list[Logger] = [CSVLogger(directory, name="logs", flush_logs_every_n_steps=20)]
    if kind == "tensorboard":
        loggers.append(_tensorboard(directory))
    if kind == "wandb":
        loggers.append(_wandb(config, directory))
    return loggers


def _tensorboard(directory: Path) -> Logger:
    try:
        return TensorBoardLogger(directory, name="tensorboard")
    except ModuleNotFoundError as error:
        raise TFLabError(
            "logger=tensorboard needs a package more: pip install tensorboard"
        ) from error


def _wandb(config: Mapping[str, Any], directory: Path) -> Logger:
    logger = WandbLogger(
        name=directory.name,
        id=directory.name,
        save_dir=directory,
        project=config["logger"]["project"],
        offline=config["logger"]["offline"],
        config=dict(config),
    )
    try:
        _ = logger.experiment  # logs in
    except wandb.Error as error:
        raise TFLabError(
            f"logger=wandb: {error} Or take logger=wandb_offline, which needs no account."
        ) from error
    return logger
