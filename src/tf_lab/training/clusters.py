"""Who begins the processes of a training: as Lightning finds out, less two surprises of Slurm."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import Any

import lightning as L
from lightning.fabric.plugins.environments import (
    LightningEnvironment,
    SLURMEnvironment,
    TorchElasticEnvironment,
)
from lightning.pytorch.utilities.rank_zero import rank_zero_only

from tf_lab.errors import TFLabError
from tf_lab.support.words import counted

NO_ANSWER = ("Connection closed by peer", "Connection reset by peer", "remote process exited")


def is_helper() -> bool:
    """Whether this is a process of a distributed training other than the first."""
    return getattr(rank_zero_only, "rank", 0) > 0


def cluster_plugins() -> list[Any]:
    """Plugins of a trainer, by which Slurm does neither of these.

    At Slurm's signal Lightning would write a checkpoint of its own, of whatever is trained, which
    it loads into whatever is trained or tested later in that trainer's folder; ours are resumed
    without. In a job of one task it would train on one device, whatever is asked for; so that task
    begins the processes.

    Raises:
        TFLabError: Slurm's job is of a kind that Lightning does not take.
    """
    if TorchElasticEnvironment.detect() or not SLURMEnvironment.detect():
        return []
    if os.environ["SLURM_NTASKS"] == "1":
        return [LightningEnvironment()]
    try:
        return [SLURMEnvironment(auto_requeue=False)]
    except RuntimeError as error:
        raise TFLabError(f"Slurm: {error}") from error


@contextlib.contextmanager
def telling_lost_processes() -> Iterator[None]:
    """Say in one line that another process of a distributed training, or test, ended.

    That one has said why; what is met here is that nobody answers.

    Raises:
        TFLabError: one did.
    """
    try:
        yield
    except RuntimeError as error:
        if not any(word in str(error) for word in NO_ANSWER):
            raise
        raise TFLabError(
            "another process of this training or test ended, and its own error says why; the same "
            f"command goes on ({str(error).splitlines()[0]})"
        ) from error


def check_processes(trainer: L.Trainer) -> None:
    """That a distributed trainer has, or will have, a process for each device.

    Raises:
        TFLabError: whoever began them began more or fewer.
    """
    devices = trainer.num_devices * trainer.num_nodes
    if trainer.world_size != devices:
        raise TFLabError(
            f"trainer.devices={trainer.num_devices}: of {counted(devices, 'device')} there are "
            f"processes for {trainer.world_size}; on {counted(trainer.num_nodes, 'node')} give "
            f"srun --ntasks-per-node={trainer.num_devices}, or torchrun --nproc-per-node="
            f"{trainer.num_devices}"
        )
