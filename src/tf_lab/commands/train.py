"""Train (or reuse the identical finished training), evaluate on the test split, print the row."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import lightning as L
import torch

from tf_lab.commands.inputs import trained_size
from tf_lab.config.build import capture_settings, check_network, check_test, ready
from tf_lab.config.schema import TEST_ON, TrainConfig
from tf_lab.config.stored import portable_config, write_config
from tf_lab.data.sources.source import DataSource, open_source
from tf_lab.data.sources.tested import content_of
from tf_lab.errors import TFLabError
from tf_lab.evaluation.protocol import check_groundtruth, groundtruth_digest
from tf_lab.evaluation.scores import format_table, read_metrics
from tf_lab.experiments.identity import row_label, run_directory, training_directory
from tf_lab.experiments.launcher import SweepJobs
from tf_lab.experiments.provenance import provenance
from tf_lab.experiments.reuse import earlier_state, print_reuse, removal
from tf_lab.network.checkpoint import load_network, save_network
from tf_lab.stereo.depth import stereo_identity
from tf_lab.support.devices import accelerator_of, use_tensor_cores
from tf_lab.support.files import check_folder, write_json
from tf_lab.support.headers import read_header, read_info
from tf_lab.support.layout import CONFIG, LAST, ORIGIN, PICTURES, WEIGHTS
from tf_lab.training.callbacks import TrainingSessions
from tf_lab.training.clusters import is_helper
from tf_lab.training.curves import loss_curve
from tf_lab.training.datamodule import SceneDataModule
from tf_lab.training.evaluation import SceneEvaluation, evaluate_network, first_says
from tf_lab.training.evaluation_log import log_run
from tf_lab.training.fit import FitSettings, fit, rank_zero_lock
from tf_lab.training.initial import (
    check_state,
    initial_path,
    initial_state,
    make_network,
    with_initial_digests,
)
from tf_lab.training.loggers import make_loggers
from tf_lab.training.module import Training
from tf_lab.training.objects import make_callbacks


def run(config: TrainConfig) -> None:
    """Train, evaluate, print the row in the paper's format."""
    use_tensor_cores()
    # what is wrong with any setting is told before data is made
    check_network(config)
    check_test(config)
    _ = config.training.chunk
    capture_settings(config)
    if config.test_on is not None and not _tested(config).has("test"):
        which = f"{TEST_ON}.test, {TEST_ON}.test_size"
        raise TFLabError(f"there is no test scene ({which}): give one, or leave test_on= out")
    config = identified(config)
    start = time.time()
    run = run_directory(config)
    reused = read_metrics(run) is not None
    if reused:
        print_reuse("evaluation", run)
    else:
        check_folder(Path(config.output))
        source = _tested(config)
        tested = source.has("test")
        if not tested and not is_helper():
            which = f"{source.group}.test, {source.group}.test_size"
            print(f"no score will be made: there is no test scene ({which})")
        checkpoint = train(config)
        if tested:
            _evaluate_training(config, checkpoint)
        if is_helper():
            return  # the first process of a distributed training does the rest
        if not tested:
            print(f"training: {checkpoint.parent}")
            return
    metrics = read_metrics(run)
    assert metrics is not None  # written just now, or found
    log_run(config, run, metrics)
    label = row_label(config)
    print(format_table([*metrics.scenes.items(), (label, metrics.mean)]))
    print(f"training: {training_directory(config)}\nrun:      {run}")
    took = "" if reused else f"   ({(time.time() - start) / 60:.1f} minutes in all)"
    print(f"pictures: {run / PICTURES}{took}")


def identified(config: TrainConfig) -> TrainConfig:
    """A config that says what is in its data and files, and on how many devices it trains.

    Raises:
        TFLabError: the shards cannot be opened, the scenes not be made, or a file not be read.
    """
    content = with_initial_digests(config, content_of(config.data, config.test_on))
    if config.groundtruth is not None:
        folder = Path(config.groundtruth)
        scenes = content.scenes.get("test", ())  # of embedded data not known before it is made
        check_groundtruth(folder, scenes)
        content = replace(content, groundtruth=groundtruth_digest(folder, scenes))
    if config.inputs.stereo:
        content = replace(content, stereo=stereo_identity())
    trainer = config.trainer
    if trainer.devices in ("auto", -1, "-1"):
        gpus = torch.cuda.device_count() if trainer.accelerator != "cpu" else 0
        trainer = replace(trainer, devices=max(1, gpus))
    return replace(config, content=content, trainer=trainer)


def finished(config: TrainConfig) -> Path | None:
    """The directory of a config's evaluation, or, without a test scene, training, if finished."""
    config = identified(config)
    run, training = run_directory(config), training_directory(config)
    if read_metrics(run) is not None:
        return run
    tested = _tested(config).has("test")
    return None if tested or not (training / WEIGHTS).exists() else training


LESS = "fewer training.chunks or training.images"
JOBS = SweepJobs("tf_lab.train", TrainConfig, row_label, finished)


def _evaluate_training(config: TrainConfig, checkpoint: Path) -> None:
    """Make the config's evaluation, unless it is there."""
    run = run_directory(config)
    with rank_zero_lock(run, "evaluating"):
        if first_says(is_helper() or read_metrics(run) is None):
            _evaluate(config, checkpoint, run)
        elif not is_helper():
            print_reuse("evaluation", run)


def _evaluate(config: TrainConfig, checkpoint: Path, run: Path) -> None:
    network, info = load_network(checkpoint)
    _check_seen(config)
    scenes = _tested(config).scenes("test")["test"]
    groundtruth = None if config.groundtruth is None else Path(config.groundtruth)
    if groundtruth is not None:
        check_groundtruth(groundtruth, scenes)
    if not is_helper():
        write_config(config, run / CONFIG)
        origin = {**provenance(), "checkpoint": str(checkpoint), **_scenes(config, "test")}
        write_json(run / ORIGIN, {**origin, **info})
    # the trainer brings it to its device
    network = ready(network, config.online, torch.device("cpu"))
    settings, metrics = capture_settings(config), [*config.metrics.values()]
    module = SceneEvaluation(network, settings, metrics, run, row_label(config), groundtruth)
    t = config.trainer
    nodes = {name: value for name, value in t.others.items() if name == "num_nodes"}
    devices = {
        "accelerator": accelerator_of(t.accelerator),
        "devices": t.devices,
        "strategy": t.strategy,
    }
    evaluate_network(module, [*scenes.values()], **devices, **nodes)


def train(config: TrainConfig) -> Path:
    """The checkpoint of the config's training: found, resumed or trained from the start."""
    directory = training_directory(config)
    checkpoint = directory / WEIGHTS
    with rank_zero_lock(directory, "training"):
        if not checkpoint.exists():
            (_train if config.optimizer.steps > 0 else _take)(config, directory, checkpoint)
        else:
            _check_whole(checkpoint)
            if not is_helper():
                print_reuse("training", directory)
    return checkpoint


def _check_whole(checkpoint: Path) -> None:
    """That a finished training's weights are there, for the state beside them has them, too.

    Raises:
        TFLabError: they are not.
    """
    try:
        read_header(checkpoint)
    except TFLabError as error:
        if isinstance(error.__cause__, OSError):  # as without permission: nothing is damaged
            raise
        last, remove = checkpoint.with_name(LAST), removal(checkpoint.parent)
        kept = f"delete it, and the same command makes it from {LAST} beside it"
        cure = kept if last.exists() else f"to train again: {remove}"
        raise TFLabError(f"{checkpoint}: damaged; {cure}") from error


def _train(config: TrainConfig, directory: Path, checkpoint: Path) -> None:
    L.seed_everything(config.seed, verbose=False)
    t, optimizer = config.training, config.optimizer
    source = open_source(config.data, config.content)
    if config.content.shards is None and not source.has("train"):
        raise TFLabError(
            "no training scene: give data.size=, or more captures than val and test hold; "
            "optimizer.steps=0 tests the weights that init= names"
        )
    network = make_network(config)
    _check_size(config)  # once the network is known to fit
    if config.trainer.compile:
        network.compile_parts()
    module = Training(
        network,
        optimizer,
        t.sdf_weight,
        capture_settings(config),
        round(t.maps_memory * 2**30),
        [*config.metrics.values()],
    )

    sessions = TrainingSessions()

    def data() -> SceneDataModule:  # once nothing more is wrong with the settings
        if not is_helper():
            write_config(config, directory / CONFIG)
            write_json(directory / ORIGIN, sessions.origin)
        train = source.chunks(t.chunk, config.model.near, config.model.far, config.inputs.stereo)
        val = [*source.scenes("val")["val"].values()]
        return SceneDataModule(train, val, config.seed, config.trainer.workers)

    validate_every = t.validate_every if source.has("val") else 0
    trainer = fit(
        module,
        data,
        directory,
        config.trainer,
        FitSettings(optimizer.steps, t.save_every, validate_every, optimizer.clip, less=LESS),
        loggers=make_loggers(config, directory),
        callbacks=[sessions, *make_callbacks(config)],
        start=partial(_start, config, directory),
    )
    if trainer.is_global_zero:
        if logs := sorted(directory.glob("logs/version_*/metrics.csv")):
            loss_curve(logs, directory / "loss.png")
        origin = {**sessions.summary(), **_scenes(config, "train"), **_init(config)}
        info = {"training": {**origin, "config": portable_config(config)}}
        save_network(network, checkpoint, info)


def _take(config: TrainConfig, directory: Path, checkpoint: Path) -> None:
    """A training of no steps: the weights that it would start from, and none of its data."""
    if not config.init:
        raise TFLabError("optimizer.steps=0: tests the weights that init= names; give init=")
    _start(config, directory)
    network = make_network(config)
    _check_size(config)
    if is_helper():
        while not checkpoint.exists():  # the first process writes it
            time.sleep(0.1)
        return
    sessions = TrainingSessions()
    write_config(config, directory / CONFIG)
    write_json(directory / ORIGIN, sessions.origin)
    info = {**sessions.summary(), **_init(config), "config": portable_config(config)}
    save_network(network, checkpoint, {"training": info})


def _check_size(config: TrainConfig) -> None:
    """Warn of images of another size than the network that ``init`` names was trained on, or of
    other images to test on than to train on.
    """
    path, tested, data = initial_path(config), _tested(config), open_source(config.data)
    if is_helper():
        return
    used = data if config.optimizer.steps > 0 else tested
    if path is not None and not initial_state(config):
        _check_sizes(f"init={config.init}: was", trained_size(read_info(path)), used)
    if used is not tested:
        _check_sizes("the network is", data.size, tested)


def _check_sizes(what: str, size: tuple[int, int] | None, source: DataSource) -> None:
    if source.size and size not in (None, source.size):
        (width, height), group = size, source.group
        print(
            f"warning: {what} trained on images of {width}x{height}, these are of "
            f"{source.size[0]}x{source.size[1]}; {group}.width={width} {group}.height={height} "
            "makes them alike",
            file=sys.stderr,
        )


def _start(config: TrainConfig, directory: Path) -> Path | None:
    """The state that ``init`` names, or the last one of the same training of fewer steps."""
    state = initial_state(config)
    if state is not None:
        check_state(state, asdict(config.optimizer))
    elif not config.init:
        state = earlier_state(config, directory)
    return state


def _check_seen(config: TrainConfig) -> None:
    """Warn of test scenes that the weights which ``init`` names were trained on."""
    origin, seen = _init(config).get("init", {}), set()
    while isinstance(origin, dict) and origin:
        seen |= {*origin.get("scenes", {}).values()}
        origin = origin.get("init")
    for name, digest in config.content.scenes.get("test", {}).items():
        if digest in seen and not is_helper():
            print(
                f"warning: {name} is tested on, and init={config.init} was trained on it",
                file=sys.stderr,
            )


def _init(config: TrainConfig) -> dict[str, Any]:
    """Where the weights come from that a training starts from, and its settings, as they say."""
    path = initial_path(config)
    if path is None or initial_state(config):  # which has its own sessions with it
        return {}
    origin = dict(read_info(path).get("training", {}))
    if "init" in origin:  # of what that one started from, where it comes from is enough
        origin["init"] = {k: v for k, v in origin["init"].items() if k != "config"}
    return {"init": origin}


def _tested(config: TrainConfig) -> DataSource:
    """The data whose test scenes are used, as they were when the run began."""
    group = "data" if config.test_on is None else TEST_ON
    return open_source(config.tested, config.content, group)


def _scenes(config: TrainConfig, split: str) -> dict[str, dict[str, str]]:
    """Which captures' scenes of a split a run uses, by the digest of their sources."""
    found = config.content.scenes.get(split)
    return {"scenes": found} if found else {}
