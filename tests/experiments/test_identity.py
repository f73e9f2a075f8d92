"""Which settings make a new training, which only a new evaluation, and what a row is called."""

import functools
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from tf_lab.config.compose import compose_config
from tf_lab.config.schema import TrainConfig
from tf_lab.config.stored import portable_config, read_config, upgraded, write_config
from tf_lab.config.typed import typed
from tf_lab.experiments.identity import (
    evaluation_identity,
    key_of,
    row_label,
    run_directory,
    training_directory,
    training_identity,
)

# Every other setting of train.yaml shapes the weights.
TEST_TIME = (
    *("views", "select.policy", "resolution", "threshold", "keyframe_distance"),
    *("data.test_size", "data.test_frames", "online.precision", "metrics"),
)
NEITHER = (
    *("data.root", "data.workers", "data.val_size", "output"),
    *("launcher.jobs", "launcher.gpus", "launcher.cpus"),
    *("logger._target_", "logger.project", "logger.offline", "logger.others"),
    *("trainer.workers", "trainer.accelerator", "trainer.compile", "trainer.max_time"),
    *("online.maps_device", "online.maps_budget", "online.batch", "online.compile"),
    *("trainer.strategy", "training.validate_every", "training.save_every"),
    *(
        "training.maps_memory",
        "init",
        "init_encoder",
        "data.furniture",
        "data.textures",
        "data.urls",
    ),
    "groundtruth",
)


@functools.cache
def composed(*overrides: str) -> TrainConfig:
    return compose_config("train", *overrides)


DEFAULT = composed()


def leaves(config: dict[str, Any], prefix: str = "") -> Iterator[str]:
    """The dotted names of all settings that a user can give."""
    for key, value in config.items():
        if isinstance(value, dict) and value:
            yield from leaves(value, f"{prefix}{key}.")
        elif not prefix.startswith("content") and key != "test_on":  # a choice
            yield f"{prefix}{key}"


def changed(name: str, settings: Any = DEFAULT) -> Any:
    """Settings with one of them changed."""
    first, _, rest = name.partition(".")
    value = settings[first] if isinstance(settings, dict) else getattr(settings, first)
    if rest:
        new = changed(rest, value)
    elif isinstance(value, bool):
        new = not value
    elif isinstance(value, tuple | list):
        new = value[:-1]
    elif isinstance(value, dict):
        new = {**value, "more": {"_target_": "package.Part"}}
    else:
        new = f"{value}0" if isinstance(value, str) else (value or 0) + 1
    if isinstance(settings, dict):
        return {**settings, first: new}
    made = replace(settings)
    object.__setattr__(made, first, new)  # whatever it may be, unchecked
    return made


def with_content(config: TrainConfig, **content: Any) -> TrainConfig:
    return replace(config, content=replace(config.content, **content))


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
    "views4_diverse": "views=4 select=diverse",
    "views8_diverse": "views=8 select=diverse",
    "views16_diverse": "views=16 select=diverse",
}


def keys(config: TrainConfig) -> tuple[str, str]:
    return key_of(training_identity(config)), key_of(evaluation_identity(config))


def test_the_same_settings_give_the_same_key() -> None:
    assert keys(compose_config("train")) == keys(DEFAULT)
    assert keys(composed("seed=0", "views=16", "fusion=transformer")) == keys(DEFAULT)


def test_a_key_does_not_depend_on_the_order_of_settings() -> None:
    """Those of a file that is read come in another than those of a command line."""
    key = key_of({"lr": 1, "seed": {"a": 0, "b": 2}})
    assert key == key_of({"seed": {"b": 2, "a": 0}, "lr": 1})
    assert len(key) == 10  # the directories that people have are called by so many


def test_the_lists_name_settings_that_exist() -> None:
    assert {*TEST_TIME, *NEITHER} <= set(leaves(asdict(DEFAULT)))


@pytest.mark.parametrize("name", sorted({*leaves(asdict(DEFAULT))} - {*TEST_TIME, *NEITHER}))
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
    if name not in ("select.policy", "metrics"):  # there is none of the changed name
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
    for option in ("trainer.devices=2", "+trainer.others.accumulate_grad_batches=2"):
        assert keys(composed(option))[0] != keys(DEFAULT)[0], option
    assert keys(composed("trainer.devices=[1]"))[0] == keys(DEFAULT)[0]  # another GPU
    assert keys(composed("trainer.devices=[0,3]"))[0] == keys(composed("trainer.devices=2"))[0]


def test_a_callback_that_may_change_the_weights_makes_a_new_training() -> None:
    watching = "+callbacks.a._target_=lightning.pytorch.callbacks.DeviceStatsMonitor"
    for option in ("callbacks=learning_rate", watching):
        assert keys(composed(option)) == keys(DEFAULT), option
    averaging = "+callbacks.a._target_=lightning.pytorch.callbacks.StochasticWeightAveraging"
    one, other = (composed(averaging, f"+callbacks.a.swa_lrs={lr}") for lr in (0.1, 0.2))
    assert len({keys(config)[0] for config in (DEFAULT, one, other)}) == 3


def test_a_run_of_before_rules_can_still_be_read() -> None:
    old = asdict(DEFAULT)
    del old["training"]["rules"], old["training"]["seen_by"], old["content"]
    old["training"]["ranked"] = 0.5
    config = typed(TrainConfig, upgraded(old))
    assert config.training.rules == {"attention": 0.5, "random": 0.5}
    assert config.training.seen_by == config.training.images
    assert row_label(config) == "Ours"


def test_a_training_of_before_matching_is_found_again() -> None:
    old = asdict(DEFAULT)
    del old["inputs"]["matching"], old["inputs"]["stereo"], old["encoder"]["name"]
    config = typed(TrainConfig, upgraded(old))
    assert keys(config) == keys(DEFAULT)
    assert training_directory(config) == training_directory(DEFAULT)


def test_a_training_of_before_maps_were_centered_is_found_again() -> None:
    """Its maps were not, whatever the default is by now."""
    old = asdict(DEFAULT)
    del old["encoder"]["centered"]
    config = typed(TrainConfig, upgraded(old))
    assert config.encoder.centered is False  # type: ignore[attr-defined]
    assert keys(config) == keys(DEFAULT)  # which is of model=tiny


def test_a_setting_that_came_later_is_no_part_of_what_had_none() -> None:
    """So that what was trained before it is found again."""
    assert "stereo" not in training_identity(DEFAULT)["inputs"]
    assert training_identity(composed("inputs=stereo"))["inputs"]["stereo"] is True


@pytest.mark.parametrize("portable", [False, True])
def test_what_is_written_is_read_again(portable: bool, tmp_path: Path) -> None:
    config = with_content(composed("row=views4_rnd", "output=a"), train="x", scenes={"test": {}})
    write_config(config, tmp_path / "config.yaml", portable)
    again = read_config(tmp_path / "config.yaml")
    assert keys(again) == keys(config)
    assert row_label(again) == row_label(config)
    assert (again.output == "a") != portable
    assert again.content.scenes == {}  # of which there may be thousands


@pytest.mark.parametrize("row", ROWS)
def test_a_row_is_its_settings_whatever_it_is_called(row: str) -> None:
    assert run_directory(composed(f"row={row}")) == run_directory(composed(*ROWS[row].split()))


def test_shards_are_known_by_what_is_in_them() -> None:
    here, there, others = (
        with_content(composed(f"data.urls={place}"), shards=digest)
        for place, digest in (("a", "x1"), ("b", "x1"), ("a", "x2"))
    )
    assert keys(here) == keys(there)
    assert keys(here)[0] != keys(others)[0]
    shuffled = composed("data.urls=a", "data.shuffle=false")
    assert keys(here)[0] != keys(with_content(shuffled, shards="x1"))[0]
    for unused in ("data.size=7", "data.frames=9"):
        assert keys(with_content(composed("data.urls=a", unused), shards="x1")) == keys(here)
    assert "urls" not in portable_config(here)["data"]


@pytest.mark.parametrize("of", ["train", "init", "encoder"])
def test_what_lies_in_files_is_known_by_its_content(of: str) -> None:
    here, there, others = (
        with_content(composed(f"init={place}", f"encoder.weights={place}"), **{of: digest})
        for place, digest in (("a", "x1"), ("b", "x1"), ("a", "x2"))
    )
    if of == "encoder":
        assert keys(here) == keys(there)
    assert keys(here)[0] != keys(others)[0]
    assert keys(here)[1] == keys(others)[1]
    assert "init" not in portable_config(here)


def test_test_scenes_are_known_by_their_content() -> None:
    data = ("data=captures", "data.root=here")
    here, there, others = (
        with_content(composed(*data, f"data.test={names}"), test=digest)
        for names, digest in (("[a]", "x1"), ("list.txt", "x1"), ("[a]", "x2"))
    )
    assert keys(here) == keys(there)
    assert keys(here)[0] == keys(others)[0]
    assert keys(here)[1] != keys(others)[1]


def test_a_training_is_the_same_whatever_it_is_tested_on() -> None:
    rooms, flats, more = (
        composed(*words.split())
        for words in ("", "test_on=flats", "test_on=flats test_on.test_size=9")
    )
    assert keys(rooms)[0] == keys(flats)[0] == keys(more)[0]
    assert len({keys(config)[1] for config in (rooms, flats, more)}) == 3
    assert keys(composed("test_on=flats", "test_on.width=80"))[1] != keys(flats)[1]
    unused = composed("test_on=flats", "data.test_size=9")  # which is of no use then
    assert keys(unused) == keys(flats)
    here = ("test_on=captures", "test_on.root=here")  # also where no digest tells them apart
    assert keys(composed(*here, "test_on.keyframe_distance=0.3"))[1] != keys(composed(*here))[1]
    assert "flats" in evaluation_identity(flats)["data"].values()


def test_images_that_are_tested_on_are_of_the_size_trained_on() -> None:
    words = ("data.width=64", "data.height=48", "test_on=captures", "test_on.root=here")
    tested = composed(*words).tested
    assert (tested.name, tested.width, tested.height) == ("captures", 64, 48)
    assert composed(*words, "test_on.width=80").tested.width == 80
    assert composed().tested is not None


@pytest.mark.parametrize("portable", [False, True])
def test_what_it_is_tested_on_is_written_and_read_again(portable: bool, tmp_path: Path) -> None:
    words = ("test_on=captures", "test_on.root=/r", "test_on.test=[a]", "test_on.turn=90")
    config = composed(*words)
    write_config(config, tmp_path / "config.yaml", portable)
    again = read_config(tmp_path / "config.yaml")
    assert keys(again) == keys(config)
    assert again.tested.root == ("" if portable else "/r")
    assert (again.tested.turn, [*again.tested.test]) == (90, ["a"])


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
    ("overrides", "name"),
    [
        ("inputs=no_depth", "no_depth"),
        ("inputs=no_ray", "no_ray"),
        ("encoder=efficientnet_lite0", "efficientnet_lite0"),
        ("refine=false", "no_refine"),
        ("filter=false", "no_filter"),
    ],
)
def test_directories_say_what_differs(overrides: str, name: str) -> None:
    for directory in (training_directory, run_directory):
        assert directory(composed(overrides)).name.startswith(f"tiny-{name}-")


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
        ("inputs=stereo", "Ours: + matching, + stereo"),
        ("fusion=gru fusion.layers=3", "Ours: w/o TRSF, GRU (ours) layers=3"),
        # all rows of a study have the same encoder
        ("encoder=efficientnet_lite0 fusion=avg", "Ours: w/o TRSF, avg"),
        ("select=diverse views=4", "Ours: 4 images, diverse (ours)"),
        ("select=diverse select.spread=0.5", "Ours: 16 images, diverse (ours) spread=0.5"),
        ("select=diverse", "Ours: 16 images, diverse (ours)"),
        # a combination that the paper does not have names both
        ("refine=false views=4", "Ours: w/o spatial ref., 4 images"),
    ],
)
def test_rows_are_called_as_in_the_paper(overrides: str, label: str) -> None:
    assert row_label(composed(*overrides.split())) == label


def test_with_shards_the_loaders_shape_the_weights() -> None:
    """Each reads a part of them; without, chunks are drawn alike by any number."""
    none, few, many = (
        with_content(composed(f"trainer.workers={n}"), shards="digest") for n in (0, 1, 3)
    )
    assert keys(few)[0] != keys(many)[0]
    assert keys(none) == keys(few)
