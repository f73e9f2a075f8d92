"""Values that no network, training or reconstruction can have are told before any work."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

from tf_lab.config.build import check_network
from tf_lab.config.compose import compose_config
from tf_lab.config.schema import TrainConfig
from tf_lab.config.typed import typed
from tf_lab.errors import TFLabError
from tf_lab.network.settings import NetworkConfig
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.support.memory import check_memory
from tf_lab.support.settings import check_ranges


@cache
def config() -> TrainConfig:
    return compose_config("train")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("seed", -1),
        ("seed", 2**32),
        ("views", 0),
        ("views", 10**400),
        ("threshold", 1.01),
        ("threshold", math.nan),
        ("keyframe_distance", math.nan),
        ("keyframe_distance", -0.1),
        ("resolution", 0.0),
        ("resolution", math.inf),
        ("optimizer.lr", math.nan),
        ("optimizer.lr", -1.0),
        ("optimizer.lr", 3e38),  # Adam divides it by 1 - beta: no number in float32
        ("optimizer.eps", 1e-300),
        ("training.sdf_weight", 1e19),
        ("optimizer.steps", -1),
        ("optimizer.betas", (0.9, 1.0)),
        ("training.chunks", 0),
        ("training.images", 0),
        ("training.points", 0),
        ("training.near_share", 1.1),
        ("training.views", (4, 0)),
        ("training.rules", {"random": -1.0}),
        ("model.width", 0),
        ("model.blocks", 10**8),
        ("model.heads", 0),
        ("online.batch", 0),
        ("data.width", 0),
        ("data.width", 100_000),
        ("trainer.workers", -1),
    ],
)
def test_a_number_out_of_its_range(name: str, value: Any) -> None:
    group, _, key = name.rpartition(".")
    if group:
        changed = replace(config(), **{group: replace(getattr(config(), group), **{key: value})})
    else:
        changed = replace(config(), **{key: value})
    check_ranges(config())
    with pytest.raises(TFLabError, match=rf"^{name}\S*=.*: must be "):
        check_ranges(changed)


def test_the_schema_checks_ranges_and_types() -> None:
    given = compose_config("evaluate", "predictions=a", "groundtruth=b")
    with pytest.raises(TFLabError, match=r"^seed=-1: must be at least 0"):
        typed(type(given), {"predictions": "a", "groundtruth": "b", "seed": -1})
    for word in ("seed=1.5", "views=1.5", "online.batch=1.5"):
        with pytest.raises(Exception, match=f"(?s){word}|whole number"):
            compose_config("reconstruct", word)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"views": 10**8}, r"^views=100000000: a room takes about [\d,]+ GiB, .* fewer views"),
        ({"resolution": 1e-5}, r"^resolution=1e-05: the mesh of a room takes about .* coarser"),
        ({"threshold": -0.1}, "^threshold=-0.1: must be at least 0 and at most 1"),
        ({"batch": 0}, "^batch=0: must be at least 1"),
    ],
)
def test_what_a_reconstruction_cannot_be(change: dict[str, Any], expected: str) -> None:
    with pytest.raises(TFLabError, match=expected):
        ReconstructionSettings(**change)


def test_memory_is_told_in_words() -> None:
    check_memory("it", 2**20, "")
    with pytest.raises(TFLabError, match=r"^it takes about 1,048,576 GiB, .*; have less"):
        check_memory("it", 2**50, "have less")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"blocks": 10**8}, "model.blocks=100000000: must be"),
        ({"heads": 0}, "model.heads=0: must be at least 1"),
        ({"far": 1e9}, "model.far=1000000000.0: must be"),
        ({"encoder": {"width": "8"}}, "encoder.width is '8', not a whole number"),
        ({"encoder": {"blocks": [10**9]}}, r"encoder.blocks=\[1000000000\]: must be"),
        ({"fusion": {"strategy": "gru", "layers": "2"}}, "fusion.layers is '2', not a whole"),
    ],
)
def test_what_a_network_cannot_be(change: dict[str, Any], expected: str) -> None:
    sizes = {"width": 8, "blocks": 1, "heads": 2, "expansion": 1.0, "hidden": 8, "refine_blocks": 1}
    NetworkConfig(**sizes)  # type: ignore[arg-type]
    with pytest.raises(TFLabError, match=expected):
        NetworkConfig(**{**sizes, **change})  # type: ignore[arg-type]


def test_a_network_larger_than_the_machine() -> None:
    check_network(config())
    huge = replace(config(), model=replace(config().model, width=8192, blocks=16))
    with pytest.raises(TFLabError, match=r"blocks=16: to train the network takes"):
        check_network(huge)
