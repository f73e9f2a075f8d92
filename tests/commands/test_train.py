"""`python -m tf_lab.train`: the main job, every ablation of the paper, sweeps, reuse, loggers."""

import csv
import json
import math
import threading
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import lightning as L
import numpy as np
import pytest
import torch
import yaml
from filelock import FileLock
from PIL import Image
from safetensors.torch import load_file

from helpers.run_directory import check_run
from helpers.tiny_jobs import TINY, Result, call, start, tiny_config, told
from tf_lab.commands.train import train as train_network
from tf_lab.network.checkpoint import load_network
from tf_lab.online.views.selection import uniform
from tf_lab.training.datamodule import SceneDataModule
from tf_lab.training.module import Training

Train = Callable[..., Result]


def test_the_main_job(main_job: Result, outputs: Path) -> None:
    """By a process of its own, in a fresh directory, to the row in the paper's format."""
    assert main_job.status == 0
    assert main_job.err == ""
    lines = main_job.out.splitlines()
    heading = next(i for i, line in enumerate(lines) if line.startswith("Method "))
    assert lines[heading].split() == [
        "Method",
        *["Acc", "Compl", "Chamfer", "Prec", "Recall", "F-score"],
    ]
    label, *row = lines[heading + 3].split()
    run = outputs.parent / main_job.path("run")
    metrics = check_run(run)
    assert label == metrics["label"] == "Ours"
    mean = metrics["mean"]
    assert row == [
        *(f"{mean[key]:.2f}" for key in ("acc", "compl", "chamfer")),
        *(f"{mean[key]:.3f}" for key in ("prec", "recall", "fscore")),
    ]
    assert "the median surface point of a test scene is seen by" in main_job.out
    assert main_job.path("pictures") == main_job.path("run") / "pictures"


def test_what_a_training_leaves(main_job: Result, outputs: Path, checkpoint: Path) -> None:
    training = checkpoint.parent
    assert training == outputs.parent / main_job.path("training")
    with Image.open(training / "loss.png") as picture:
        assert picture.size > (100, 100)
    assert yaml.safe_load((training / "config.yaml").read_text())["optimizer"]["steps"] == 5
    assert torch.load(training / "last.ckpt", weights_only=True)["global_step"] == 5  # to go on
    network, info = load_network(checkpoint)
    assert network.config.width == 8
    assert info["training"]["command"].startswith("python -m tf_lab.train data.size=1 ")
    assert info["training"]["seconds"] > 0


@pytest.mark.parametrize(
    "overrides",
    [
        *("fusion=avg", "fusion=pred", "inputs=no_depth", "inputs=no_ray"),
        *("refine=false", "filter=false", "views=4 select=rnd"),
    ],
)
def test_every_ablation_runs(train: Train, overrides: str) -> None:
    result = train(*overrides.split())
    assert (result.status, result.err) == (0, "")
    metrics = check_run(result.path("run"))
    assert metrics["label"].startswith("Ours: ")
    assert f"\n{metrics['label']} " in result.out
    assert (result.path("training") / "loss.png").exists()
    network, _ = load_network(result.path("training") / "model.safetensors")
    changed = {
        "fusion=avg": network.config.fusion == {"strategy": "avg"},
        "fusion=pred": network.config.fusion == {"strategy": "pred"},
        "inputs=no_depth": not network.config.depth,
        "inputs=no_ray": not network.config.ray,
        "refine=false": not network.config.refine,
        "filter=false": not network.config.filter,
        "views=4 select=rnd": (  # of the training, or of an evaluation that another test made
            overrides.startswith("views") and "reusing the identical finished" in result.out
        ),
    }
    assert changed[overrides]
    assert sum(changed.values()) == 1


def test_a_second_start_reuses_all(train: Train) -> None:
    first = train()
    metrics = first.path("run") / "metrics.json"
    before = metrics.stat().st_mtime_ns
    (details,) = json.loads(metrics.read_text())["details"].values()
    assert 0 <= details["view_sets"]["visible"] <= 1
    second = train()
    assert f"reusing the identical finished evaluation {first.path('run')}" in second.out
    assert "note: " not in second.out
    assert second.path("training") == first.path("training")
    assert metrics.stat().st_mtime_ns == before
    assert second.path("run") == first.path("run")
    row = next(line for line in first.out.splitlines() if line.startswith("Ours "))
    assert row in second.out


def test_the_same_seed_gives_the_same_weights_and_meshes(
    train: Train, main_job: Result, outputs: Path, tmp_path: Path
) -> None:
    """To the bit, by another process in another folder."""
    again = train(f"output={tmp_path}")
    runs = (outputs.parent / main_job.path("run"), again.path("run"))
    first, second = (run / "meshes" / "room_2000000.ply" for run in runs)
    assert first.read_bytes() == second.read_bytes()
    trainings = (outputs.parent / main_job.path("training"), again.path("training"))
    weights = [load_file(training / "model.safetensors") for training in trainings]
    assert weights[0].keys() == weights[1].keys()
    assert [
        name for name in weights[0] if not torch.equal(weights[0][name], weights[1][name])
    ] == []


@pytest.mark.usefixtures("outputs")
def test_another_seed_changes_all_that_is_random(monkeypatch: pytest.MonkeyPatch) -> None:
    """Initialisation, chunks, which of a chunk's views are kept, and the reservoir."""
    made: list[tuple[Training, SceneDataModule]] = []

    def fit(trainer: L.Trainer, module: Training, data: SceneDataModule, **_: object) -> None:
        made.append((module, data))
        raise KeyboardInterrupt

    monkeypatch.setattr(L.Trainer, "fit", fit)
    for seed in (0, 1, 0):
        with pytest.raises(KeyboardInterrupt):
            train_network(tiny_config(f"seed={seed}", "training.views=[1,2]"))
    first, other, same = (
        (
            module.network.state_dict(),
            [batch.world_T_cam for batch in islice(data.train_dataloader(), 3)],
            [(batch.keep, batch.draws.tolist()) for batch in islice(data.train_dataloader(), 20)],
            uniform(module.capture_settings.seed, *lattice),
        )
        for module, data in made
        for lattice in [(torch.arange(30).view(10, 3), torch.arange(10))]
    )
    torch.testing.assert_close(first, same, rtol=0, atol=0)
    for one, two in zip(first, other, strict=True):
        with pytest.raises(AssertionError):
            torch.testing.assert_close(one, two, rtol=0, atol=0)
    fixed = {name for name, value in first[0].items() if torch.equal(value, other[0][name])}
    assert not {name for name in fixed if first[0][name].unique().numel() > 2}


def test_a_training_waits_for_another_of_the_same_key(checkpoint: Path, tmp_path: Path) -> None:
    """Then it takes that one's result."""
    config = tiny_config(f"output={tmp_path}")
    directory = tmp_path / "trainings" / checkpoint.parent.name
    directory.mkdir(parents=True)
    found: list[Path] = []
    waiting = threading.Thread(target=lambda: found.append(train_network(config)))
    with FileLock(directory / ".lock"):
        waiting.start()
        waiting.join(0.5)
        assert waiting.is_alive()
        (directory / "model.safetensors").write_bytes(checkpoint.read_bytes())
    waiting.join(30)
    assert found == [directory / "model.safetensors"]
    assert found[0].read_bytes() == checkpoint.read_bytes()


def logged(training: Path) -> dict[str, list[float]]:
    """The numbers of the CSV log by name."""
    values: dict[str, list[float]] = {}
    for path in training.glob("logs/version_*/metrics.csv"):
        with path.open() as file:
            for row in csv.DictReader(file):
                for name, text in row.items():
                    if text:
                        values.setdefault(name, []).append(float(text))
    return values


def test_losses_and_scores_of_whole_val_rooms_are_logged(train: Train, tmp_path: Path) -> None:
    result = train(
        *("optimizer.steps=10", "training.validate_every=5", "logger=tensorboard"),
        f"output={tmp_path}",
    )
    assert (result.status, result.err) == (0, "")
    values = logged(result.path("training"))
    assert values.keys() >= {f"train/{x}" for x in ("loss", "coarse", "fine", "occupancy")}
    assert len(values["train/loss"]) == 2  # every fifth step
    assert all(math.isfinite(value) for value in values["train/loss"])
    assert len(values["val/fscore"]) == 2
    assert list((result.path("training") / "tensorboard").rglob("events.out.tfevents.*"))
    assert "val F" in result.out


def test_without_a_val_room(train: Train, tmp_path: Path) -> None:
    result = train("data.val_size=0", "training.validate_every=5", f"output={tmp_path}")
    assert (result.status, result.err) == (0, "")
    assert "val/fscore" not in logged(result.path("training"))


@pytest.mark.slow
@pytest.mark.usefixtures("outputs")
def test_two_processes_train_together(tmp_path: Path) -> None:
    """The first holds the locks and writes; both evaluate, after a training or alone."""
    two = ("trainer.devices=2", "trainer.strategy=ddp", "data.test_size=3")
    for more in ((), ("views=4",)):
        result = start("train", *TINY, *two, *more, cwd=tmp_path)
        assert result.status == 0, result.err
        assert "GLOBAL_RANK: 1, MEMBER: 2/2" in result.err
        assert result.out.count("Method ") == 1
        metrics = json.loads((tmp_path / result.path("run") / "metrics.json").read_text())
        assert [*metrics["scenes"]] == [f"room_200000{i}" for i in range(3)]
    assert "reusing the identical finished training" in result.out


@pytest.mark.slow
@pytest.mark.usefixtures("outputs")
@pytest.mark.timeout(1800)
def test_two_processes_learn_as_one_with_the_batch_of_both(tmp_path: Path) -> None:
    """The same losses on the same batches: rounding apart at first, and what it grows to later."""
    ways = {
        "one": ("training.chunks=2",),
        "two": ("training.chunks=1", "trainer.devices=2", "trainer.strategy=ddp"),
        "unlearning": ("training.chunks=2", "optimizer.lr=0"),
    }
    curves = {}
    for name, way in ways.items():
        result = start("train", *TINY, "optimizer.steps=200", *way, cwd=tmp_path)
        assert result.status == 0, result.err
        curves[name] = np.array(logged(tmp_path / result.path("training"))["train/loss"])
    learned = curves["unlearning"] - curves["one"]
    difference = np.abs(curves["two"] - curves["one"])
    assert len(learned) == 40  # every fifth step
    assert learned[20:].mean() > 0.1 * curves["unlearning"][20:].mean()
    assert (difference[:8] < 1e-5).all()
    assert difference.mean() < 0.01 * learned.mean()


@pytest.mark.slow
def test_wandb_offline(train: Train, tmp_path: Path) -> None:
    result = train("logger=wandb_offline", f"output={tmp_path}")
    assert result.status == 0
    for directory in (result.path("training"), result.path("run")):  # losses, scores
        assert list((directory / "wandb").glob("offline-run-*/*.wandb"))
    media = [*(result.path("run") / "wandb").glob("offline-run-*/files/media/*")]
    assert {path.name for path in media} >= {"table", "images", "object3D"}


def test_bf16_and_a_worker_process(train: Train, tmp_path: Path) -> None:
    result = train("trainer.precision=bf16-mixed", "trainer.workers=1", f"output={tmp_path}")
    assert (result.status, result.err) == (0, "")
    check_run(result.path("run"))


def test_without_a_test_scene_it_trains_and_says_that_there_is_no_score(
    train: Train, checkpoint: Path
) -> None:
    result = train("data.test_size=0")
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith("no score will be made: there is no test scene")
    assert result.path("training") == checkpoint.parent
    assert "F-score" not in result.out


def test_without_a_training_scene_it_ends_before_any_is_made(train: Train, tmp_path: Path) -> None:
    places = (f"data.root={tmp_path / 'cache'}", f"output={tmp_path / 'out'}")
    result = train("data.size=0", "data.val_size=0", "data.test_size=0", *places)
    told(result, "no training scene: give data.size=")
    assert not (tmp_path / "cache").exists()


def test_an_interrupt_says_that_it_goes_on(monkeypatch: pytest.MonkeyPatch, outputs: Path) -> None:
    def interrupt(config: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tf_lab.commands.train.train", interrupt)
    result = call("train", f"output={outputs}")
    assert result.status == 130
    assert result.err == (
        "interrupted: what is finished and the last checkpoint are kept, the same command goes on "
        "from them; a test begins again\n"
    )
