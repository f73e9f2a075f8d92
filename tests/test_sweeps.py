"""The sweeps of sweeps/: what they run, in which order, and that W&B's run the same."""

import functools
from collections.abc import Sequence
from dataclasses import replace

import pytest
import yaml
from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser

from tf_lab.config.compose import compose_config, conf_dir
from tf_lab.config.registration import register
from tf_lab.config.schema import TrainConfig
from tf_lab.experiments.identity import row_label, run_directory, training_directory

SWEEPS = conf_dir() / "sweep"
# the rows of the paper's tables 1 and 2 that are ours, by the part of the label that is not
MAIN = {
    "",
    "w/o TRSF, avg",
    "w/o TRSF, pred",
    "w/o spatial ref.",
    "w/o C2F filter",
    *(f"{k} images, RND" for k in (4, 8, 16)),
    *(f"{k} images" for k in (4, 8)),
}
INPUTS = {"w/o projected depth", "w/o view ray"}
OWN = {"+ matching", *(f"{k} images, diverse (ours)" for k in (4, 8, 16))}


@functools.cache
def composed(*overrides: str) -> TrainConfig:
    return compose_config("train", *overrides)


def job(overrides: Sequence[str]) -> TrainConfig:
    """The config of a job; its row is composed once for all seeds."""
    (seed,) = (word for word in overrides if word.startswith("seed="))
    row = composed(*(word for word in overrides if word != seed))
    return replace(row, seed=int(seed.removeprefix("seed=")))


def jobs(name: str) -> list[TrainConfig]:
    """The configs of a sweep's jobs in the order in which they run."""
    register()
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        hydra = compose("train", [f"sweep={name}"], return_hydra_config=True).hydra
    params = hydra.sweeper.params
    parsed = OverridesParser.create().parse_overrides([f"{k}={v}" for k, v in params.items()])
    (batch,) = BasicSweeper.split_arguments(parsed, None)
    return [job(overrides) for overrides in batch]


def rows(configs: list[TrainConfig]) -> set[tuple[str, int]]:
    return {(row_label(c).removeprefix("Ours").removeprefix(": "), c.seed) for c in configs}


@pytest.mark.parametrize(
    ("name", "expected", "trainings"),
    [
        ("main_ablation", MAIN, 5),
        ("inputs", {"", *INPUTS}, 3),
        ("views", {label for label in MAIN if "images" in label} | {""}, 1),
        ("all", MAIN | INPUTS, 7),
        ("study", MAIN | INPUTS | OWN, 8),
    ],
)
def test_a_sweep_is_a_table_or_chart_of_the_paper(
    name: str, expected: set[str], trainings: int
) -> None:
    configs = jobs(name)
    assert rows(configs) == {(label, seed) for label in expected for seed in (0, 1, 2)}
    assert len({run_directory(c) for c in configs}) == len(configs) == 3 * len(expected)
    assert len({training_directory(c) for c in configs}) == 3 * trainings
    # of a seed, those that have to train come first: the others never wait while they could
    first = [training_directory(c) for c in configs[: len(expected)]]
    assert len(set(first[:trainings])) == trainings


def test_a_seed_is_one_setting() -> None:
    assert job(["seed=2", "row=avg"]) == compose_config("train", "seed=2", "row=avg")


def test_every_sweep_is_tested() -> None:
    assert {path.stem for path in SWEEPS.glob("*.yaml")} == {
        "main_ablation",
        "inputs",
        "views",
        "all",
        "study",
    }


def test_wandbs_sweep_runs_the_same() -> None:
    sweep = yaml.safe_load((SWEEPS / "wandb" / "main_ablation.yaml").read_text())
    values = {key: parameter["values"] for key, parameter in sweep["parameters"].items()}
    assert sweep["method"] == "grid"
    assert sweep["command"][1:] == [
        *("python", "-m", "tf_lab.train", "logger=wandb", "${args_no_hyphens}"),
    ]
    # the agent puts every parameter in as key=value
    configs = [
        job(["logger=wandb", f"seed={seed}", f"row={row}"])
        for seed in values["seed"]
        for row in values["row"]
    ]
    assert [run_directory(c) for c in configs] == [run_directory(c) for c in jobs("main_ablation")]
