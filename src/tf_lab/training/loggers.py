"""Where losses are logged, beside the files of a training."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers import CSVLogger, Logger

from tf_lab.config.groups import LoggerSettings
from tf_lab.config.schema import TrainConfig
from tf_lab.errors import TFLabError
from tf_lab.training.objects import make

WANDB = "WandbLogger"


def make_loggers(config: TrainConfig, directory: Path) -> Sequence[Logger]:
    """The CSV logger, which the loss curve is drawn from, and the one that is asked for.

    Raises:
        TFLabError: it is no logger; or its package or its account is missing.
    """
    loggers: list[Logger] = [CSVLogger(directory, name="logs", flush_logs_every_n_steps=20)]
    settings = config.logger
    if settings._target_ is None:
        return loggers
    arguments: dict[str, Any] = {"save_dir": directory}
    if is_wandb(settings):
        arguments |= {"name": directory.name, "id": directory.name, "config": asdict(config)}
        arguments |= {"project": settings.project, "offline": settings.offline}
    node = {"_target_": settings._target_, **settings.others}
    try:
        logger = make(Logger, "logger", node, **arguments)
    except ModuleNotFoundError as error:
        name = settings._target_.rpartition(".")[2].removesuffix("Logger").lower()
        raise TFLabError(f"logger={name} needs a package more: pip install {name}") from error
    if is_wandb(settings):
        with account():
            _ = getattr(logger, "experiment")  # noqa: B009  # logs in
    return [*loggers, logger]


def is_wandb(settings: LoggerSettings) -> bool:
    """Whether it is Weights & Biases."""
    return str(settings._target_).endswith(f".{WANDB}")


@contextlib.contextmanager
def account() -> Iterator[None]:
    """Tell in one line that there is none, or what else W&B says."""
    import wandb  # slow to import; only who logs there waits for it

    try:
        yield
    except wandb.Error as error:
        raise TFLabError(
            f"logger=wandb: {error} Or take logger=wandb_offline, which needs no account."
        ) from error
