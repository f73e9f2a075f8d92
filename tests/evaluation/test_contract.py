"""All metrics against the contract, and metrics that break it against the checks."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from tf_lab.evaluation import METRICS, PAPER, MetricPart
from tf_lab.evaluation.contract import (
    CHECKS,
    better_is_said,
    it_is_a_finite_number,
    it_is_of_its_input_alone,
    settings_shape_scores,
    the_worlds_axes_do_not_matter,
)
from tf_lab.evaluation.metrics import Comparison
from tf_lab.support.settings import setting

Check = Callable[[Any], None]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("part", list(METRICS), ids=lambda part: part.name)
def test_contract(part: MetricPart, check: Check) -> None:
    check(part.name)


def test_the_papers_come_first_in_its_order() -> None:
    assert [part.name for part in METRICS][:6] == [*PAPER]
    assert [METRICS[name].higher_is_better for name in PAPER] == [False] * 3 + [True] * 3


@dataclass(frozen=True)
class NearSettings:
    """Share of the ground truth that is near."""

    name: str = setting("near", "of the metric", shapes="scores")
    within: float = setting(0.02, "metres", shapes="scores")


@dataclass(frozen=True)
class WeightsSettings:
    name: str = setting("near", "of the metric", shapes="scores")
    within: float = setting(0.02, "metres", shapes="weights")


def near(found: Comparison, within: float) -> float:
    return float((found.to_prediction < within).mean())


def nan(found: Comparison, within: float) -> float:
    return near(found, within) if found.faces is not None else float("nan")


def high(found: Comparison, within: float) -> float:
    return near(found, within) + float(found.truth[:, 2].mean())


def greedy(found: Comparison, within: float) -> float:
    result = near(found, within)
    found.visible[:] = True
    return result


drawn = np.random.default_rng(0)


def moody(found: Comparison, within: float) -> float:
    return near(found, within) + float(drawn.random())


def part_of(function: Callable[..., float], **others: Any) -> MetricPart:
    target = f"{__name__}:{function.__name__}"
    return replace(MetricPart("near", target, NearSettings, heading="Near"), **others)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_one_that_keeps_it(check: Check, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METRICS._parts, "near", part_of(near))
    check("near")
    check(NearSettings(within=0.05))


@pytest.mark.parametrize(
    ("check", "part"),
    [
        (it_is_a_finite_number, part_of(nan)),
        (the_worlds_axes_do_not_matter, part_of(high)),
        (it_is_of_its_input_alone, part_of(greedy)),
        (it_is_of_its_input_alone, part_of(moody)),
        (better_is_said, part_of(near, higher_is_better=False)),
        (better_is_said, part_of(near, higher_is_better=None)),
        (better_is_said, part_of(near, empty=1.5)),
        (settings_shape_scores, part_of(near, settings=WeightsSettings)),
    ],
)
def test_what_breaks_it(check: Check, part: MetricPart, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METRICS._parts, "near", part)
    with pytest.raises(AssertionError):
        check("near")
