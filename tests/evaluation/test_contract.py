"""Every registered metric keeps the contract, and the harness sees one that does not."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tf_lab.evaluation import METRICS, PAPER, MetricPart
from tf_lab.evaluation.contract import check_metric
from tf_lab.evaluation.metrics import Comparison
from tf_lab.support.settings import setting


@pytest.mark.parametrize("part", [*METRICS], ids=lambda part: part.name)
def test_keeps_the_contract(part: MetricPart) -> None:
    check_metric(part)


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


def part_of(function: object, **others: object) -> MetricPart:
    target = f"{__name__}:{function.__name__}"  # type: ignore[attr-defined]
    return replace(MetricPart("near", target, NearSettings, heading="Near"), **others)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (part_of(near), None),
        (part_of(nan), "not finite"),
        (part_of(high), "world's frame"),
        (part_of(greedy), "changes its input"),
        (part_of(moody), "not pure"),
        (part_of(near, higher_is_better=False), "on it"),
        (part_of(near, higher_is_better=None), "not said"),
        (part_of(near, empty=1.5), "empty mesh is better"),
        (part_of(near, settings=WeightsSettings), "shapes weights"),
        (part_of(near, format=".0f"), "is shown as"),
    ],
)
def test_what_breaks_it_is_said(
    part: MetricPart, message: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(METRICS._parts, "near", part)
    if message is None:
        check_metric(part)
        return
    with pytest.raises(AssertionError, match=message):
        check_metric(part)
