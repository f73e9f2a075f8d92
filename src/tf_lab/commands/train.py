"""Train (or reuse the identical finished training), evaluate on the test split, print the row."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.plugins.io import TorchCheckpointIO
from lightning.pytorch.utilities.exceptions import MisconfigurationException
from lightning.pytorch.utilities.rank_zero import rank_zero_only

from tf_lab.config.build import build_network, capture_settings, ready
from tf_lab.config.schema import TrainConfig
from tf_lab.config.stored import portable_config, write_config
from tf_lab.data.sources.source import open_source
from tf_lab.errors import TFLabError
from tf_lab.evaluation.scores import format_table, read_metrics
from tf_lab.experiments.identity import row_label, run_directory, training_directory
from tf_lab.experiments.launcher import SweepJobs
from tf_lab.experiments.provenance import provenance
from tf_lab.experiments.reuse import earlier_state, print_reuse
from tf_lab.network.checkpoint import load_network, save_network
from tf_lab.support.files import atomic_path, held, remove_abandoned, write_json
from tf_lab.training.curves import loss_curve
from tf_lab.training.datamodule import SceneDataModule
from tf_lab.training.evaluation import SceneEvaluation, evaluate_network, first_says
from tf_lab.training.initial import (
    check_state,
    initial_state,
    make_network,
    with_initial_digests,
)
from tf_lab.training.loggers import log_scores, make_loggers
from tf_lab.training.module import Sittings, Training, TrainingProgress

log = logging.getLogger(__name__)


def run(config: TrainConfig) -> None:
    """Train, evaluate, print the row in the paper's format."""
    torch.set_float32_matmul_precision("high")
    build_network(config), config.training.chunk  # what is wrong is told before data is made
    config = identified(config)
    start = time.time()
    run = run_directory(config)
    if read_metrics(run) is not None:
        print_reuse("evaluation", run)
    else:
        tested = open_source(config.data, config.content).has("test")
        if not tested and not _is_helper():
            print("no score will be made: there is no test scene (data.test, data.test_size)")
        checkpoint = train(config)
        if tested:
            evaluate_training(config, checkpoint)
        if _is_helper():
            return  # the first process of a distributed training does the rest
        if not tested:
            print(f"training: {checkpoint.parent}")
            return
    metrics = read_metrics(run)
    assert metrics is not None  # written just now, or found
    log_scores(config, run, metrics["mean"])
    label = row_label(config)
    print(format_table([*metrics["scenes"].items(), (label, metrics["mean"])]))
    print(f"training: {training_directory(config)}\nrun:      {run}")
    print(f"pictures: {run / 'pictures'}   ({(time.time() - start) / 60:.1f} minutes in all)")


def identified(config: TrainConfig) -> TrainConfig:
    """A config that says what is in its data and files, and on how many devices it trains.

    Raises:
        TFLabError: the shards cannot be opened, the scenes not be made, or a file not be read.
    """
    content = with_initial_digests(config, open_source(config.data).content())
    trainer = config.trainer
    if trainer.devices in ("auto", -1, "-1"):
        gpus = torch.cuda.device_count() if trainer.accelerator != "cpu" else 0
        trainer = replace(trainer, devices=max(1, gpus))
    return replace(config, content=content, trainer=trainer)


def finished(config: TrainConfig) -> Path | None:
    """The directory of a config's evaluation, if that is finished."""
    run = run_directory(identified(config))
    return run if read_metrics(run) is not None else None


JOBS = SweepJobs("tf_lab.train", TrainConfig, row_label, finished)


def evaluate_training(config: TrainConfig, checkpoint: Path) -> Path:
    """The run directory of the config's evaluation: found, or made now."""
    run = run_directory(config)
    with nullcontext() if _is_helper() else held(run, "evaluates"):
        if first_says(_is_helper() or read_metrics(run) is None):
            _evaluate(config, checkpoint, run)
        elif not _is_helper():
            print_reuse("evaluation", run)
    return run


def _evaluate(config: TrainConfig, checkpoint: Path, run: Path) -> None:
    network, info = load_network(checkpoint)
    scenes = [*open_source(config.data, config.content).scenes("test")["test"].values()]
    if not _is_helper():
        write_config(config, run / "config.yaml")
        origin = {**provenance(), "checkpoint": str(checkpoint), **_scenes(config, "test")}
        write_json(run / "run.json", {**origin, **info})
    # the trainer brings it to its device
    network = ready(network, config.online, torch.device("cpu"))
    settings, metrics = capture_settings(config), [*config.metrics.values()]
    module = SceneEvaluation(network, settings, metrics, run, row_label(config))
    t = config.trainer
    nodes = {name: value for name, value in t.others.items() if name == "num_nodes"}
    devices = {"accelerator": t.accelerator, "devices": t.devices, "strategy": t.strategy}
    evaluate_network(module, scenes, **devices, **nodes)


def train(config: TrainConfig) -> Path:
    """The checkpoint of the config's training: found, resumed or trained from the start."""
    directory = training_directory(config)
    checkpoint = directory / "model.safetensors"
    if _is_helper():  # the first process holds the lock for all
        if not checkpoint.exists():
            _fit(config, directory, checkpoint)
        return checkpoint
    with held(directory, "trains"):
        if checkpoint.exists():
            print_reuse("training", directory)
            return checkpoint
        remove_abandoned(directory)  # by a training that was killed while it saved
        write_config(config, directory / "config.yaml")
        _fit(config, directory, checkpoint)
    return checkpoint


def _is_helper() -> bool:
    """Whether this is a process of a distributed training other than the first."""
    return getattr(rank_zero_only, "rank", 0) > 0


def _fit(config: TrainConfig, directory: Path, checkpoint: Path) -> None:
    L.seed_everything(config.seed, verbose=False)
    network, optimizer = make_network(config), config.optimizer
    memory = round(config.training.maps_memory * 2**30)
    settings = capture_settings(config)
    module = Training(
        network, optimizer, config.training.sdf_weight, settings, memory, [*config.metrics.values()]
    )
    sittings = Sittings()
    trainer = _trainer(config, [_saving(config, directory), sittings], directory)
    # whatever is wrong so far is told before the data is made
    source = open_source(config.data, config.content)
    train = source.chunks(config.training.chunk, config.model.near, config.model.far)
    val = [*source.scenes("val")["val"].values()]
    if config.trainer.compile:
        network.compile_parts()
    data = SceneDataModule(train, val, config.seed, config.trainer.workers)
    state = _state_to_go_on_from(config, directory)
    trainer.fit(module, data, ckpt_path=state, weights_only=True)
    if trainer.global_step < optimizer.steps:
        raise KeyboardInterrupt  # Lightning turns the signal into a silent end
    trainer.save_checkpoint(directory / "last.ckpt")  # to train on
    if trainer.is_global_zero:
        origin = {
            **sittings.summary(),
            **_scenes(config, "train"),
            "config": portable_config(config),
        }
        info = {"training": origin}
        logs = sorted(directory.glob("logs/version_*/metrics.csv"))
        if logs:
            loss_curve(logs, directory / "loss.png")
        save_network(network, checkpoint, info)


def _scenes(config: TrainConfig, split: str) -> dict[str, dict[str, str]]:
    """Which captures' scenes of a split a run uses, by the digest of their sources."""
    found = config.content.scenes.get(split)
    return {"scenes": found} if found else {}


def _state_to_go_on_from(config: TrainConfig, directory: Path) -> Path | None:
    """Of this training, interrupted; else as ``init`` says; else of the same one of fewer steps."""
    last = directory / "last.ckpt"
    if last.exists():
        _check(last)
        print(f"resuming {last}")
        return last
    state = initial_state(config)
    if state is not None:
        check_state(state, asdict(config.optimizer))
    elif not config.init:
        state = earlier_state(config, directory)
    if state is not None:
        print(f"going on from {state}")
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


def _check(last: Path) -> None:
    """That the checkpoint to resume from can be read."""
    try:
        torch.load(last, map_location="cpu", weights_only=True)
    except Exception as error:  # any damage
        raise TFLabError(
            f"{last}: damaged ({type(error).__name__}); delete it to start this training again"
        ) from error


def _saving(config: TrainConfig, directory: Path) -> ModelCheckpoint:
    return ModelCheckpoint(
        directory,
        filename="last",
        every_n_train_steps=config.training.save_every,
        save_top_k=1,
        enable_version_counter=False,
        save_on_train_epoch_end=False,
    )


def _trainer(config: TrainConfig, callbacks: Sequence[Callback], directory: Path) -> L.Trainer:
    t = config.trainer
    arguments = {
        "accelerator": t.accelerator,
        "devices": t.devices,
        "precision": t.precision,
        "strategy": t.strategy,
        **t.others,
    }
    steps, every = config.optimizer.steps, config.training.validate_every
    validate = every and open_source(config.data, config.content).has("val")
    try:
        return L.Trainer(
            max_steps=steps,
            val_check_interval=min(every, steps) if every else None,
            limit_val_batches=1.0 if validate else 0,
            check_val_every_n_epoch=None,
            num_sanity_val_steps=0,
            gradient_clip_val=config.optimizer.clip or None,
            callbacks=[*callbacks, TrainingProgress()],
            plugins=[AtomicSaves()],
            logger=make_loggers(config, directory),
            log_every_n_steps=5,
            enable_progress_bar=False,
            enable_model_summary=False,
            use_distributed_sampler=False,
            **arguments,
        )
    except (MisconfigurationException, TypeError, ValueError) as error:
        raise TFLabError(f"trainer: {error}; see the files in conf/trainer") from error
