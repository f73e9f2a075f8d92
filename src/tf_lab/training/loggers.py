"""Where losses and scores are logged, beside the files of a training and a run."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers import CSVLogger, Logger

from tf_lab.config.groups import LoggerSettings
from tf_lab.config.schema import TrainConfig
from tf_lab.errors import TFLabError
from tf_lab.experiments.identity import training_directory
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
    if _is_wandb(settings):
        arguments |= {"name": directory.name, "id": directory.name, "config": asdict(config)}
        arguments |= {"project": settings.project, "offline": settings.offline}
    node = {"_target_": settings._target_, **settings.others}
    try:
        logger = make(Logger, "logger", node, **arguments)
    except ModuleNotFoundError as error:
        name = settings._target_.rpartition(".")[2].removesuffix("Logger").lower()
        raise TFLabError(f"logger={name} needs a package more: pip install {name}") from error
    if _is_wandb(settings):
        with _account():
            _ = getattr(logger, "experiment")  # noqa: B009  # logs in
    return [*loggers, logger]


def _is_wandb(settings: LoggerSettings) -> bool:
    return str(settings._target_).endswith(f".{WANDB}")


@contextlib.contextmanager
def _account() -> Iterator[None]:
    import wandb  # slow to import; only who logs there waits for it

    try:
        yield
    except wandb.Error as error:
        raise TFLabError(
            f"logger=wandb: {error} Or take logger=wandb_offline, which needs no account."
        ) from error


def log_scores(config: TrainConfig, run: Path, mean: Mapping[str, float]) -> None:
    """Log the scores of an evaluation with W&B, if that is asked for.

    An evaluation is a W&B run of its own, because a training may have many; but under
    ``wandb agent`` all belongs to the one run that the agent has begun.
    """
    if not _is_wandb(config.logger):
        return
    import wandb

    if "WANDB_SWEEP_ID" not in os.environ:
        wandb.finish()  # the training's
    with _account():
        session = wandb.run or wandb.init(
            name=run.name,
            id=run.name,
            group=training_directory(config).name,
            job_type="evaluation",
            dir=run,
            project=config.logger.project,
            mode="offline" if config.logger.offline else None,
            config=asdict(config),
            resume="allow",
        )
    session.log({f"test/{key}": value for key, value in mean.items()})
    session.finish()
