"""Train (or reuse the identical finished training), evaluate on the test split, print the row.

python -m tf_lab.train [overrides]
"""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import lightning as L
import torch
import yaml
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.plugins.io import TorchCheckpointIO
from lightning.pytorch.utilities.exceptions import MisconfigurationException
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from tf_lab.cli.command import command, in_sweep, plain
from tf_lab.config.build import (
    build_network,
    make_network,
    optimizer_settings,
    ready,
    test_settings,
)
from tf_lab.config.datasets import has_scenes, identified, prepare_data, training_chunks
from tf_lab.errors import TFLabError
from tf_lab.evaluation.scores import format_table, read_metrics
from tf_lab.experiments.identity import portable, row_label, run_directory, training_directory
from tf_lab.experiments.jobs import check_launcher, end_with_parent, run_job
from tf_lab.experiments.provenance import provenance
from tf_lab.experiments.reuse import earlier_state, say_reused
from tf_lab.network.checkpoint import load_network, save_network
from tf_lab.support.files import atomic_path, held, remove_abandoned, write_json
from tf_lab.training.curves import loss_curve
from tf_lab.training.datamodule import SceneDataModule
from tf_lab.training.evaluation import SceneEvaluation, evaluate_network, first_says
from tf_lab.training.initial import check_state, initial_state
from tf_lab.training.loggers import log_scores, make_loggers
from tf_lab.training.module import Sittings, Training, TrainingProgress

log = logging.getLogger(__name__)
Config = Mapping[str, Any]


@command("train", before=check_launcher, goes_on=True)
def main(cfg: DictConfig) -> None:
    """Train, evaluate, print the row in the paper's format."""
    end_with_parent()
    if in_sweep():
        run_job("tf_lab.train", row_label(cfg), cfg.seed, partial(_finished, cfg))
        return
    config = plain(cfg)
    build_network(config), optimizer_settings(config)  # what is wrong is told before data is made
    config = identified(config)
    start = time.time()
    run = run_directory(config)
    if read_metrics(run) is not None:
        say_reused("evaluation", run)
    else:
        tested = has_scenes(config, "test")
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


def _finished(cfg: DictConfig) -> Path | None:
    """The run directory of a sweep's job, if its evaluation is finished."""
    try:
        run = run_directory(identified(plain(cfg)))
        return run if read_metrics(run) is not None else None
    except (TFLabError, OmegaConfBaseException):
        return None  # the job's own process says what is wrong


def evaluate_training(config: Config, checkpoint: Path) -> Path:
    """The run directory of the config's evaluation: found, or made now."""
    run = run_directory(config)
    with nullcontext() if _is_helper() else held(run, "evaluates"):
        if first_says(_is_helper() or read_metrics(run) is None):
            _evaluate(config, checkpoint, run)
        elif not _is_helper():
            say_reused("evaluation", run)
    return run


def _evaluate(config: Config, checkpoint: Path, run: Path) -> None:
    network, info = load_network(checkpoint)
    scenes = prepare_data(config, ("test",))["test"]
    if not _is_helper():
        write_config(run, config)
        origin = {**provenance(), "checkpoint": str(checkpoint), **_scenes(config, "test")}
        write_json(run / "run.json", {**origin, **info})
    network = ready(network, config, torch.device("cpu"))  # the trainer brings it to its device
    settings = test_settings(config)
    module = SceneEvaluation(network, settings, run=run, label=row_label(config))
    places = ("accelerator", "devices", "num_nodes", "strategy")
    devices = {key: config["trainer"][key] for key in places if key in config["trainer"]}
    evaluate_network(module, scenes, **devices)


def train(config: Config) -> Path:
    """The checkpoint of the config's training: found, resumed or trained from the start."""
    directory = training_directory(config)
    checkpoint = directory / "model.safetensors"
    if _is_helper():  # the first process holds the lock for all
        if not checkpoint.exists():
            _fit(config, directory, checkpoint)
        return checkpoint
    with held(directory, "trains"):
        if checkpoint.exists():
            say_reused("training", directory)
            return checkpoint
        remove_abandoned(directory)  # by a training that was killed while it saved
        write_config(directory, config)
        _fit(config, directory, checkpoint)
    return checkpoint


def _is_helper() -> bool:
    """Whether this is a process of a distributed training other than the first."""
    return getattr(rank_zero_only, "rank", 0) > 0


def _fit(config: Config, directory: Path, checkpoint: Path) -> None:
    L.seed_everything(config["seed"], verbose=False)
    network, optimizer = make_network(config), optimizer_settings(config)
    t = config["training"]
    memory = round(t["maps_memory"] * 2**30)
    module = Training(network, optimizer, t["sdf_weight"], test_settings(config), memory)
    sittings = Sittings()
    trainer = _trainer(config, [_saving(config, directory), sittings], directory)
    # whatever is wrong so far is told before the data is made
    train, val = training_chunks(config), prepare_data(config, ("val",))["val"]
    if config["trainer"]["compile"]:
        network.compile_parts()
    data = SceneDataModule(train, val, config["seed"], config["trainer"]["workers"])
    state = _state_to_go_on_from(config, directory)
    trainer.fit(module, data, ckpt_path=state, weights_only=True)
    if trainer.global_step < optimizer.steps:
        raise KeyboardInterrupt  # Lightning turns the signal into a silent end
    trainer.save_checkpoint(directory / "last.ckpt")  # to train on
    if trainer.is_global_zero:
        origin = {**sittings.summary(), **_scenes(config, "train"), "config": portable(config)}
        info = {"training": origin}
        logs = sorted(directory.glob("logs/version_*/metrics.csv"))
        if logs:
            loss_curve(logs, directory / "loss.png")
        save_network(network, checkpoint, info)


def _scenes(config: Config, split: str) -> Config:
    """Which captures' scenes of a split a run uses, by the digest of their sources."""
    found = config.get("scene_digests", {}).get(split)
    return {"scenes": found} if found else {}


def _state_to_go_on_from(config: Config, directory: Path) -> Path | None:
    """Of this training, interrupted; else as ``init`` says; else of the same one of fewer steps."""
    last = directory / "last.ckpt"
    if last.exists():
        _check(last)
        print(f"resuming {last}")
        return last
    state = initial_state(config)
    if state is not None:
        check_state(state, asdict(optimizer_settings(config)))
    elif not config.get("init"):
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


def _saving(config: Config, directory: Path) -> ModelCheckpoint:
    return ModelCheckpoint(
        directory,
        filename="last",
        every_n_train_steps=config["training"]["save_every"],
        save_top_k=1,
        enable_version_counter=False,
        save_on_train_epoch_end=False,
    )


def _trainer(config: Config, callbacks: Sequence[Callback], directory: Path) -> L.Trainer:
    arguments = {k: v for k, v in config["trainer"].items() if k not in ("compile", "workers")}
    steps, every = config["optimizer"]["steps"], config["training"]["validate_every"]
    validate = every and has_scenes(config, "val")
    try:
        return L.Trainer(
            max_steps=steps,
            val_check_interval=min(every, steps) if every else None,
            limit_val_batches=1.0 if validate else 0,
            check_val_every_n_epoch=None,
            num_sanity_val_steps=0,
            gradient_clip_val=config["optimizer"]["clip"] or None,
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


def write_config(directory: Path, config: Config) -> None:
    """Save a resolved config; its scenes, which may be many, are in ``run.json``."""
    config = {key: value for key, value in config.items() if key != "scene_digests"}
    with atomic_path(directory / "config.yaml") as temporary:
        temporary.write_text(yaml.safe_dump(config, sort_keys=False))


if __name__ == "__main__":
    torch.set_float32_matmul_precision("high")
    main()
