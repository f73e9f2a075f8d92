"""Fitting a LightningModule, whatever it is: by one process at a time, resumed, saved whole."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.loggers import Logger
from lightning.pytorch.plugins.io import TorchCheckpointIO
from lightning.pytorch.utilities.exceptions import MisconfigurationException

from tf_lab.config.groups import TrainerSettings
from tf_lab.errors import TFLabError
from tf_lab.support.devices import accelerator_of
from tf_lab.support.files import atomic_path, remove_abandoned, telling_no_space
from tf_lab.support.layout import CONFIG, LAST, ORIGIN
from tf_lab.support.locks import LOCK, NOTE, directory_lock
from tf_lab.support.memory import telling_no_memory
from tf_lab.support.stops import as_parent
from tf_lab.training.callbacks import TrainingProgress
from tf_lab.training.clusters import (
    check_processes,
    cluster_plugins,
    is_helper,
    telling_lost_processes,
)
from tf_lab.training.finite import Finite
from tf_lab.training.objects import instantiated
from tf_lab.training.state import read_state

PLANS = (CONFIG, ORIGIN, "hparams.yaml")  # files that say what is to be done


@dataclass(frozen=True)
class FitSettings:
    """How long a module is fitted, and what happens on the way.

    Attributes:
        steps: in all.
        save_every: steps between checkpoints to resume from.
        validate_every: steps between validations; 0: none.
        clip: largest gradient norm; 0: any.
        less: settings that make a step take less memory.
    """

    steps: int
    save_every: int
    validate_every: int = 0
    clip: float = 0.0
    less: str = ""


@contextlib.contextmanager
def rank_zero_lock(directory: Path, activity: str) -> Iterator[None]:
    """Work in a directory while no other training does; what killed ones half wrote is removed.

    The first process of a distributed training holds the lock for all. A directory that was made
    for work which is refused before it has any result is removed.
    """
    if is_helper():
        yield
        return
    with directory_lock(directory, activity) as made:
        remove_abandoned(directory)
        try:
            yield
        except TFLabError:
            if made:
                _remove_plans(directory)
            raise


def _remove_plans(directory: Path) -> None:
    """Empty a directory in which there are plans only, and no result."""
    paths = [path for path in directory.rglob("*") if path.name not in (LOCK, NOTE)]
    if all(path.is_dir() or path.name in PLANS for path in paths):
        for path in sorted(paths, reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()


def fit(
    module: L.LightningModule,
    data: Callable[[], L.LightningDataModule],
    directory: Path,
    trainer: TrainerSettings,
    settings: FitSettings,
    *,
    loggers: Sequence[Logger],
    callbacks: Sequence[Callback] = (),
    start: Callable[[], Path | None] = lambda: None,
) -> L.Trainer:
    """Fit a module from its last checkpoint in the directory on; inside `rank_zero_lock`.

    Args:
        module: trained in place.
        data: makes the data, after all has been told that is wrong with the trainer.
        directory: for checkpoints, of which the last stays there.
        trainer: on what and how it computes.
        settings: see `FitSettings`.
        loggers: of losses and scores.
        callbacks: beside those that save and show the progress.
        start: finds the state to go on from if there is none in the directory; None: from nothing.

    Returns:
        The trainer, at its last step; one that has not begun where early stopping ended an earlier
        call.

    Raises:
        TFLabError: wrong settings of the trainer, a damaged checkpoint, numbers gone wrong, or too
            little memory or space.
        KeyboardInterrupt: its time is over, or a callback ended it; the next call goes on.
    """
    made = _trainer(directory, trainer, settings, loggers, callbacks)
    batches = data()
    last = directory / LAST
    resumes = last.exists()
    if resumes:
        ended = _ours(last, module)
        if _stopped_early(ended):  # with no more to do than to say so again
            module.load_state_dict(ended["state_dict"])
            return made
    state = last if resumes else start()
    if state is not None and not is_helper():
        print(f"{'resuming' if resumes else 'going on from'} {state}")
    others = as_parent(deaf=False)  # of the other processes of a distributed training
    cures = [*filter(None, [settings.less]), "trainer.precision=16-mixed on a GPU"]
    less = telling_no_memory(str(directory), f"a step has to take less: {', '.join(cures)}")
    try:
        with others, telling_no_space(directory), less, telling_lost_processes():
            made.fit(module, batches, ckpt_path=state, weights_only=True)
    except MisconfigurationException as error:  # of a callback, which fit asks
        raise TFLabError(f"callbacks or trainer: {error}") from error
    made.save_checkpoint(last)  # to train on
    if made.global_step < settings.steps and not _is_enough(made):
        raise KeyboardInterrupt
    return made


def _is_enough(trainer: L.Trainer) -> bool:
    """Whether a training that ended before its last step is finished, by early stopping."""
    reasons = [c.stopping_reason_message for c in trainer.early_stopping_callbacks]
    reason = next(filter(None, reasons), None)
    if reason is not None and not is_helper():
        print(f"finished at step {trainer.global_step} of {trainer.max_steps}: {reason}")
    # another process may have seen it alone
    return trainer.strategy.reduce_boolean_decision(reason is not None, all=False)


def _stopped_early(state: dict[str, Any]) -> bool:
    """Whether early stopping ended the training that saved a state."""
    callbacks = state["callbacks"].values()
    return any(isinstance(c, dict) and c.get("stopping_reason_message") for c in callbacks)


class _NotStopped(Callback):
    """Forgets why the training stopped early whose state this one goes on from."""

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        for callback in trainer.early_stopping_callbacks:
            callback.stopping_reason_message = None


def score(
    module: L.LightningModule, data: Callable[[], L.LightningDataModule], trainer: TrainerSettings
) -> dict[str, Any]:
    """What the validation of a module logs; nothing is trained or written."""
    with tempfile.TemporaryDirectory() as nowhere:
        made = _trainer(Path(nowhere), trainer, FitSettings(1, 1, 1), [], [])
        made.validate(module, data(), verbose=False)
    return dict(made.callback_metrics)


def _ours(last: Path, module: L.LightningModule) -> dict[str, Any]:
    """The state in a checkpoint that can be resumed from.

    Raises:
        TFLabError: it cannot be read, or is of another network.
    """
    try:
        state = read_state(last)
    except TFLabError as error:
        raise TFLabError(f"{error}; delete it to start this training again") from error
    own, theirs = (
        {name: getattr(value, "shape", None) for name, value in weights.items()}
        for weights in (module.state_dict(), state["state_dict"])
    )
    if own != theirs:
        first = next(k for k in {**own, **theirs} if own.get(k) != theirs.get(k))
        raise TFLabError(
            f"{last}: of another network (first: {first}); delete it to start this training again"
        )
    return state


class AtomicSaves(TorchCheckpointIO):
    """Writes checkpoints beside their final place, so that a kill never leaves half of one.

    Lightning's own way moves them there from the system's temporary directory, which on another
    file system means copying.
    """

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any | None = None
    ) -> None:
        """Write ``checkpoint`` to ``path``, whole or not at all."""
        with atomic_path(Path(path)) as temporary:
            torch.save(checkpoint, temporary)

    def load_checkpoint(self, *arguments: Any, **others: Any) -> dict[str, Any]:
        """Read a checkpoint, without the timer's state: a limit of time is of one session."""
        checkpoint: dict[str, Any] = super().load_checkpoint(*arguments, **others)
        checkpoint.get("callbacks", {}).pop("Timer", None)
        return checkpoint


class _WholeSteps(Callback):
    """Goes on after the last whole step: batches of one that was broken off are met again.

    Lightning would count them as done, and accumulate gradients over other batches than without
    the break.
    """

    def on_load_checkpoint(
        self, trainer: L.Trainer, pl_module: L.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        progress = checkpoint["loops"]["fit_loop"]["epoch_loop.batch_progress"]
        done = checkpoint["global_step"] * trainer.accumulate_grad_batches
        if progress["total"]["ready"] != done:
            for counts in (progress["current"], progress["total"]):
                counts.update(dict.fromkeys(counts, done))


def _trainer(
    directory: Path,
    trainer: TrainerSettings,
    settings: FitSettings,
    loggers: Sequence[Logger],
    callbacks: Sequence[Callback],
) -> L.Trainer:
    saving = ModelCheckpoint(
        directory,
        filename=LAST.removesuffix(".ckpt"),
        every_n_train_steps=settings.save_every,
        save_top_k=1,
        enable_version_counter=False,
        save_on_train_epoch_end=False,
    )
    always = [Finite(directory / LAST), saving, _WholeSteps(), _NotStopped()]
    every = min(settings.validate_every, settings.steps)
    batches = every * trainer.others.get("accumulate_grad_batches", 1)
    accelerator = accelerator_of(trainer.accelerator)
    try:
        made = L.Trainer(
            default_root_dir=directory,
            max_steps=settings.steps,
            max_time=trainer.max_time,
            val_check_interval=batches or None,
            limit_val_batches=1.0 if every > 0 else 0,
            check_val_every_n_epoch=None,
            num_sanity_val_steps=0,
            gradient_clip_val=settings.clip or None,
            callbacks=[*always, *callbacks, TrainingProgress()],
            plugins=[AtomicSaves(), *cluster_plugins()],
            logger=list(loggers),
            log_every_n_steps=5,
            enable_progress_bar=False,
            enable_model_summary=False,
            use_distributed_sampler=False,
            accelerator=accelerator,
            devices=trainer.devices,
            precision=trainer.precision,  # type: ignore[arg-type]  # Lightning says what it takes
            strategy=trainer.strategy,
            **instantiated("trainer.others", trainer.others),
        )
    except (MisconfigurationException, ImportError, TypeError, ValueError) as error:
        raise TFLabError(f"trainer: {error}; see the files in conf/trainer") from error
    check_processes(made)
    return made
