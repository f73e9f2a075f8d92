"""Which settings make a new training, which only a new evaluation, and what a row is called."""

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir

from tf_lab.cli.command import conf_dir, plain
from tf_lab.experiments.identity import (
    evaluation_identity,
    key_of,
    portable,
    row_label,
    run_directory,
    training_directory,
    training_identity,
)

# Every other setting of train.yaml shapes the weights.
TEST_TIME = (
    *("views", "select.policy", "resolution", "threshold", "keyframe_distance"),
    *("data.test_size", "data.test_frames", "online.precision"),
)
NEITHER = (
    *("data.root", "data.workers", "data.val_size", "logger.kind", "output"),
    *("trainer.workers", "trainer.accelerator", "trainer.compile"),
    *("online.maps_device", "online.maps_budget", "online.batch", "online.compile"),
    *("trainer.strategy", "training.validate_every", "training.save_every"),
    *("training.maps_memory", "init"),
)


def composed(*overrides: str) -> dict[str, Any]:
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        return plain(compose("train", overrides=list(overrides)))


DEFAULT = composed()


def leaves(config: dict[str, Any], prefix: str = "") -> Iterator[str]:
    """The dotted names of all settings."""
    for key, value in config.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"


def changed(name: str) -> dict[str, Any]:
    """The default config with one setting changed."""
    config = copy.deepcopy(DEFAULT)
    *path, last = name.split(".")
    part = config
    for key in path:
        part = part[key]
    value = part[last]
    if isinstance(value, bool):
        part[last] = not value
    elif isinstance(value, list):
        part[last] = value[:-1]
    else:
        part[last] = f"{value}0" if isinstance(value, str) else (value or 0) + 1
    return config


# the rows of the paper's tables and ours beyond them, by their names on the command line
ROWS = {
    "ours": "",
    "avg": "fusion=avg",
    "pred": "fusion=pred",
    "no_refine": "refine=false",
    "no_filter": "filter=false",
    "no_depth": "inputs=no_depth",
    "no_ray": "inputs=no_ray",
    "matching": "inputs=matching",
    "views4_rnd": "views=4 select=rnd",
    "views4": "views=4",
    "views8_rnd": "views=8 select=rnd",
    "views8": "views=8",
    "views16_rnd": "views=16 select=rnd",
}


def keys(config: dict[str, Any]) -> tuple[str, str]:
    return key_of(training_identity(config)), key_of(evaluation_identity(config))


def test_the_same_settings_give_the_same_key() -> None:
    assert keys(composed()) == keys(DEFAULT)
    assert keys(composed("seed=0", "views=16", "fusion=transformer")) == keys(DEFAULT)


def test_the_lists_name_settings_that_exist() -> None:
    assert {*TEST_TIME, *NEITHER} <= set(leaves(DEFAULT))


@pytest.mark.parametrize("name", sorted({*leaves(DEFAULT)} - {*TEST_TIME, *NEITHER}))
def test_what_shapes_the_weights_makes_a_new_training(name: str) -> None:
    config = changed(name)
    assert keys(config)[0] != keys(DEFAULT)[0]
    assert training_directory(config) != training_directory(DEFAULT)
    assert run_directory(config) != run_directory(DEFAULT)


@pytest.mark.parametrize("name", TEST_TIME)
def test_what_shapes_the_test_makes_a_new_evaluation_of_the_same_training(name: str) -> None:
    config = changed(name)
    assert training_directory(config) == training_directory(DEFAULT)
    assert keys(config)[1] != keys(DEFAULT)[1]
    assert run_directory(config) != run_directory(DEFAULT)


@pytest.mark.parametrize("name", NEITHER)
def test_what_shapes_neither_makes_nothing_new(name: str) -> None:
    assert keys(changed(name)) == keys(DEFAULT)


def test_options_change_the_keys_as_their_settings_do() -> None:
    for option in ("fusion=avg", "inputs=no_depth", "model=small", "seed=1", "refine=false"):
        assert keys(composed(option))[0] != keys(DEFAULT)[0], option
    assert keys(composed("views=4", "select=rnd"))[0] == keys(DEFAULT)[0]
    for option in ("logger=wandb_offline", "trainer.strategy=ddp", "data.root=elsewhere"):
        assert keys(composed(option)) == keys(DEFAULT), option


def test_whatever_changes_the_batch_makes_a_new_training() -> None:
    for option in ("trainer.devices=2", "+trainer.accumulate_grad_batches=2"):
        assert keys(composed(option))[0] != keys(DEFAULT)[0], option


def test_a_run_of_before_rules_can_still_be_read() -> None:
    old = copy.deepcopy(DEFAULT)
    del old["training"]["rules"], old["training"]["seen_by"]
    old["training"]["ranked"] = 0.5
    assert keys(old)[0] != keys(DEFAULT)[0]  # it kept other views
    assert row_label(old) == "Ours"


def test_a_training_of_before_matching_is_found_again() -> None:
    old = copy.deepcopy(DEFAULT)
    del old["inputs"]["matching"]
    assert keys(old) == keys(DEFAULT)
    assert row_label(old) == "Ours"
    assert training_directory(old) == training_directory(DEFAULT)


@pytest.mark.parametrize("row", ROWS)
def test_a_row_is_its_settings_whatever_it_is_called(row: str) -> None:
    assert run_directory(composed(f"row={row}")) == run_directory(composed(*ROWS[row].split()))


def test_shards_are_known_by_what_is_in_them() -> None:
    here, there, others = (
        composed("data=shards", f"data.urls={place}", f"data.identity={identity}")
        for place, identity in (("a", "x1"), ("b", "x1"), ("a", "x2"))
    )
    assert keys(here) == keys(there)
    assert keys(here)[0] != keys(others)[0]
    assert keys(here)[0] != keys(composed("data=shards", "data.urls=a", "data.shuffle=false"))[0]
    assert "urls" not in portable(here)["data"]


@pytest.mark.parametrize("of", ["train", "init", "encoder"])
def test_what_lies_in_files_is_known_by_its_content(of: str) -> None:
    here, there, others = (
        composed(f"init={place}", f"encoder.weights={place}") | {"digests": {of: digest}}
        for place, digest in (("a", "x1"), ("b", "x1"), ("a", "x2"))
    )
    if of == "encoder":
        assert keys(here) == keys(there)
    assert keys(here)[0] != keys(others)[0]
    assert keys(here)[1] == keys(others)[1]
    assert "init" not in portable(here)


def test_test_scenes_are_known_by_their_content() -> None:
    data = ("data=captures", "data.root=here")
    here, there, others = (
        composed(*data, f"data.test={names}") | {"digests": {"test": digest}}
        for names, digest in (("[a]", "x1"), ("list.txt", "x1"), ("[a]", "x2"))
    )
    assert keys(here) == keys(there)
    assert keys(here)[0] == keys(others)[0]
    assert keys(here)[1] != keys(others)[1]


def test_directories_lie_in_the_output_and_say_what_they_are() -> None:
    config = composed("output=results", "fusion=avg", "seed=3", "views=8", "select=rnd")
    training, run = training_directory(config), run_directory(config)
    assert training.parent == Path("results/trainings")
    assert run.parent == Path("results/runs")
    assert training.name == f"tiny-avg-seed3-{key_of(training_identity(config))}"
    assert run.name.startswith("tiny-avg-views8-rnd-seed3-")
    ours = composed("inputs=matching", "select=diverse")
    assert run_directory(ours).name.startswith("tiny-matching-views16-diverse-seed0-")


@pytest.mark.parametrize(
    ("overrides", "label"),
    [
        # tables 1 and 2 of the paper, to the letter
        ("", "Ours"),
        ("fusion=avg", "Ours: w/o TRSF, avg"),
        ("fusion=pred", "Ours: w/o TRSF, pred"),
        ("refine=false", "Ours: w/o spatial ref."),
        ("views=4 select=rnd", "Ours: 4 images, RND"),
        ("views=4", "Ours: 4 images"),
        ("views=8 select=rnd", "Ours: 8 images, RND"),
        ("views=8", "Ours: 8 images"),
        ("select=rnd", "Ours: 16 images, RND"),
        ("filter=false", "Ours: w/o C2F filter"),
        ("inputs=no_depth", "Ours: w/o projected depth"),
        ("inputs=no_ray", "Ours: w/o view ray"),
        # ours, not the paper's
        ("inputs=matching", "Ours: + matching"),
        ("encoder=efficientnet_lite0", "Ours: efficientnet_lite0 encoder"),
        ("select=diverse views=4", "Ours: 4 images, diverse"),
        ("select=diverse", "Ours: 16 images, diverse"),
        # a combination that the paper does not have names both
        ("refine=false views=4", "Ours: w/o spatial ref., 4 images"),
    ],
)
def test_rows_are_called_as_in_the_paper(overrides: str, label: str) -> None:
    assert row_label(composed(*overrides.split())) == label
