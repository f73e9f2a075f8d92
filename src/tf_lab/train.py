"""Train (or reuse the identical finished training), evaluate on the test split, print the row.

python -m tf_lab.train [overrides]
"""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import lightning as L
import torch
import yaml
from filelock import FileLock
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger, Logger, TensorBoardLogger, WandbLogger
from lightning.pytorch.plugins.io import TorchCheckpointIO
from lightning.pytorch.utilities.exceptions import MisconfigurationException
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from omegaconf import DictConfig

from tf_lab.checkpoint import load_network, save_network
from tf_lab.commands import command, device_of, plain, provenance
from tf_lab.configuration import make_network, optimizer_settings, ready, test_settings
from tf_lab.data.datamodule import SceneDataModule
from tf_lab.datasets import identified, prepare_data, training_chunks
from tf_lab.errors import TFLabError
from tf_lab.evaluation.protocol import format_table
from tf_lab.files import atomic_path, remove_abandoned, write_json
from tf_lab.pictures import loss_curve
from tf_lab.study.runs import portable, row_label, run_directory, training_directory
from tf_lab.testing import read_metrics, test_network
from tf_lab.training import Training, TrainingProgress

log = logging.getLogger(__name__)
Config = Mapping[str, Any]


@command("train")
def main(cfg: DictConfig) -> None:
    """Train, evaluate, print the row in the paper's format."""
    config = identified(plain(cfg))
    start = time.time()
    checkpoint = train(config)
    if _is_helper():
        return  # the first process of a distributed training does the rest
    run = evaluate_training(config, checkpoint)
    metrics = read_metrics(run)
    assert metrics is not None  # written just now, or found
    label = row_label(config)
    print(format_table([*metrics["scenes"].items(), (label, metrics["mean"])]))
    print(f"training: {checkpoint.parent}\nrun:      {run}")
    print(f"pictures: {run / 'pictures'}   ({(time.time() - start) / 60:.1f} minutes in all)")


def evaluate_training(config: Config, checkpoint: Path) -> Path:
    """The run directory of the config's evaluation: found, or made now."""
    run = run_directory(config)
    run.mkdir(parents=True, exist_ok=True)
    with FileLock(run / ".lock"):
        if read_metrics(run) is not None:
            print(f"reusing the identical finished evaluation {run}")
            return run
        network, info = load_network(checkpoint)
        scenes = prepare_data(config, ("test",))["test"]
        if not scenes:
            raise TFLabError(
                f"there is no test scene (data.test); the training is done: {checkpoint}"
            )
        write_config(run, config)
        write_json(run / "run.json", {**provenance(), "checkpoint": str(checkpoint), **info})
        device = device_of("cpu" if config["trainer"]["accelerator"] == "cpu" else "auto")
        network = ready(network, config, device)
        test_network(network, scenes, test_settings(config), run, row_label(config))
    return run


def train(config: Config) -> Path:
    """The checkpoint of the config's training: found, resumed or trained from the start."""
    directory = training_directory(config)
    directory.mkdir(parents=True, exist_ok=True)
    checkpoint = directory / "model.safetensors"
    if _is_helper():  # the first process holds the lock for all
        if not checkpoint.exists():
            _fit(config, directory, checkpoint)
        return checkpoint
    with FileLock(directory / ".lock"):
        if checkpoint.exists():
            print(f"reusing the identical finished training {directory}")
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
    train, val = training_chunks(config), prepare_data(config, ("val",))["val"]
    network = make_network(config)
    if config["trainer"]["compile"]:
        network.compile_parts()
    optimizer = optimizer_settings(config)
    module = Training(network, optimizer, config["training"]["sdf_weight"], test_settings(config))
    data = SceneDataModule(train, val, config["seed"], config["trainer"]["workers"])
    trainer = _trainer(config, directory)
    last = directory / "last.ckpt"
    if last.exists():
        _check(last)
        print(f"resuming {last}")
    start, origin = time.time(), provenance()  # of the code that trains, not of what HEAD becomes
    trainer.fit(module, data, ckpt_path=str(last) if last.exists() else None, weights_only=True)
    if trainer.global_step < optimizer.steps:
        raise KeyboardInterrupt  # Lightning turns the signal into a silent end
    if trainer.is_global_zero:
        seconds = round(time.time() - start, 1)
        info = {"training": {**origin, "config": portable(config), "seconds": seconds}}
        logs = sorted(directory.glob("logs/version_*/metrics.csv"))
        if logs:
            loss_curve(logs, directory / "loss.png")
        save_network(network, checkpoint, info)
        last.unlink(missing_ok=True)


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


def _trainer(config: Config, directory: Path) -> L.Trainer:
    arguments = {k: v for k, v in config["trainer"].items() if k not in ("compile", "workers")}
    t = config["training"]
    steps = config["optimizer"]["steps"]
    saving = ModelCheckpoint(
        directory,
        filename="last",
        every_n_train_steps=t["save_every"],
        save_top_k=1,
        enable_version_counter=False,
        save_on_train_epoch_end=False,
    )
    validate = t["validate_every"]
    try:
        return L.Trainer(
            max_steps=steps,
            val_check_interval=min(validate, steps) if validate else None,
            limit_val_batches=1.0 if validate and config["data"]["val_size"] else 0,
            check_val_every_n_epoch=None,
            num_sanity_val_steps=0,
            gradient_clip_val=config["optimizer"]["clip"] or None,
            callbacks=[saving, TrainingProgress()],
            plugins=[AtomicSaves()],
            logger=make_logger(config, directory),
            log_every_n_steps=5,
            enable_progress_bar=False,
            enable_model_summary=False,
            use_distributed_sampler=False,
            **arguments,
        )
    except (MisconfigurationException, TypeError, ValueError) as error:
        raise TFLabError(f"trainer: {error}; see the files in conf/trainer") from error


def make_logger(config: Config, directory: Path) -> Sequence[Logger]:
    """The CSV logger, which the loss curve is drawn from, and the one that is asked for."""
    kind = config["logger"]["kind"]
    loggers: list[Logger] = [CSVLogger(directory, name="logs", flush_logs_every_n_steps=20)]
    if kind == "tensorboard":
        loggers.append(TensorBoardLogger(directory, name="tensorboard"))
    if kind == "wandb":
        loggers.append(
            WandbLogger(
                name=directory.name,
                id=directory.name,
                save_dir=directory,
                project=config["logger"]["project"],
                offline=config["logger"]["offline"],
                config=dict(config),
            )
        )
    return loggers


def write_config(directory: Path, config: Config) -> None:
    """Save a resolved config."""
    with atomic_path(directory / "config.yaml") as temporary:
        temporary.write_text(yaml.safe_dump(dict(config), sort_keys=False))


if __name__ == "__main__":
    torch.set_float32_matmul_precision("high")
    main()
