"""What is there already, and whether another code made it."""

from __future__ import annotations

import glob
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

from tf_lab.config.schema import TrainConfig
from tf_lab.config.stored import read_config
from tf_lab.errors import TFLabError
from tf_lab.experiments.identity import key_of, training_identity
from tf_lab.experiments.provenance import (
    Origin,
    code_version,
    commit,
    commits_of,
    sessions_of,
)
from tf_lab.support.headers import read_info
from tf_lab.support.layout import CONFIG, LAST, ORIGIN, RUNS, TRAININGS, WEIGHTS
from tf_lab.support.records import read_record, record
from tf_lab.support.settings import shaping


def origin_of(directory: Path) -> Origin:
    """The provenance of a finished training, or of an evaluation and (``training``) its training.

    Raises:
        TFLabError: it is missing or damaged.
    """
    checkpoint, run = directory / WEIGHTS, directory / ORIGIN
    cure = f"to make it anew: {removal(directory)}"
    if not checkpoint.exists():
        return read_record(Origin, run, cure)
    try:
        return record(Origin, read_info(checkpoint).get("training", {}), "training")
    except ValueError as error:
        raise TFLabError(f"{checkpoint}: {error}; {cure}") from error


def saved_state(last: Path) -> dict[str, Any]:
    """What ``last.ckpt`` of an unfinished training holds."""
    import torch  # slow to import, and only here needed

    state: dict[str, Any] = torch.load(last, map_location="cpu", mmap=True, weights_only=True)
    return state


def removal(directory: Path) -> str:
    """The command that removes a training or an evaluation, so that it is made anew."""
    name = shlex.quote(str(directory))
    known = directory.resolve().parent.name in (TRAININGS, RUNS)
    return f"python -m tf_lab.runs rm {name}" if known else f"rm -r {name}"


def print_reuse(what: str, directory: Path) -> None:
    """Print that a finished training or evaluation is reused, and whether another code made it."""
    print(f"reusing the identical finished {what} {directory}", flush=True)
    try:
        origin = origin_of(directory)
    except TFLabError:
        origin = {}
    training = origin.get("training", origin)
    makers = [origin, *sessions_of(training)]
    if any(maker.get("code") != code_version() for maker in makers):
        now = commits_of([{"commit": commit()}])
        print(
            f"note: another code made it (commit {commits_of(makers)}, now {now}); "
            f"to make it anew: {removal(directory)}"
        )


def earlier_state(config: TrainConfig, directory: Path) -> Path | None:
    """The last state of the same training of fewer steps, if this one would pass through it.

    That is so unless the schedule depends on the number of steps: then a note says how to go on
    from that state nevertheless, which makes another training. Another note names a state of this
    training on other devices or in another precision, which it does not go on from.

    Args:
        config: of a training.
        directory: of that training; the others lie beside it.
    """
    steps, found = config.optimizer.steps, []
    beside = glob.escape(directory.name.rpartition("-")[0])
    for path in directory.parent.glob(f"{beside}-*/{LAST}"):
        try:
            other = read_config(path.parent / CONFIG)
        except TFLabError:
            continue
        fewer = other.optimizer.steps < steps and _but_for_steps(other) == _but_for_steps(config)
        words = "fewer steps" if fewer else _computed_otherwise(other, config)
        if not words:
            continue
        try:
            step = int(saved_state(path)["global_step"])
        except Exception:  # any damage
            print(f"note: {path} is of this training with {words}, but damaged; it is not used")
            continue
        if fewer:
            found.append((step, path))
        else:
            more = f"; init={path} goes on from its state" if step < steps else ""
            print(
                f"note: {path.parent} is this training with {words}, at step {step} of {steps}: "
                f"with the same setting it is used{more}"
            )
    step, last = max(found, default=(0, None))
    if last is None or config.optimizer.schedule == "inverse_sqrt":
        return last
    print(
        f"note: {last.parent} is this training of fewer steps, and its schedule was planned for "
        f"those; this one starts anew. To go on from its step {step}: init={last}"
    )
    return None


def _computed_otherwise(other: TrainConfig, config: TrainConfig) -> str:
    """How the trainer of the same training is set otherwise, in words; nothing if it is another."""
    theirs, ours = shaping(other.trainer, "weights"), shaping(config.trainer, "weights")
    alike = replace(other, trainer=config.trainer)
    if theirs == ours or training_identity(alike) != training_identity(config):
        return ""
    names = [name for name in {**theirs, **ours} if theirs.get(name) != ours.get(name)]
    return " ".join(f"trainer.{name}={getattr(other.trainer, name)}" for name in names)


def _but_for_steps(config: TrainConfig) -> str:
    optimizer = replace(config.optimizer, steps=1)
    return key_of(training_identity(replace(config, optimizer=optimizer)))
