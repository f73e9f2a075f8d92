"""Where losses and scores are logged, beside the files of a training and a run."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from lightning.pytorch.loggers import CSVLogger, Logger, TensorBoardLogger, WandbLogger

from tf_lab.config.schema import TrainConfig
from tf_lab.errors import TFLabError
from tf_lab.experiments.identity import training_directory


def make_loggers(config: TrainConfig, directory: Path) -> Sequence[Logger]:
    """The CSV logger, which the loss curve is drawn from, and the one that is asked for.

    Raises:
        TFLabError: its package or its account is missing.
    """
    kind = config.logger.kind
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


def _wandb(config: TrainConfig, directory: Path) -> Logger:
    logger = WandbLogger(
        name=directory.name,
        id=directory.name,
        save_dir=directory,
        project=config.logger.project,
        offline=config.logger.offline,
        config=asdict(config),
    )
    with _account():
        _ = logger.experiment  # logs in
    return logger


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
    if config.logger.kind != "wandb":
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
