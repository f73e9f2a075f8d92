"""Intervals and p-values against scipy's, against a simulation of coverage, and known answers."""

import numpy as np
import pytest
from scipy import stats

from tf_lab.reporting.statistics import SMALLEST_P, deviation, estimate, holm


def test_deviation() -> None:
    assert deviation(np.array([0.5, 0.6, 0.7])) == pytest.approx(0.1)  # with N - 1
    assert deviation(np.array([0.5])) is None


@pytest.mark.parametrize("shape", [(1, 60), (60, 1)])
def test_one_seed_or_one_scene_is_a_paired_t_test(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(0.6, 0.05, 60), rng.normal(0.585, 0.05, 60)
    known = stats.ttest_rel(a, b)
    low, high = known.confidence_interval(0.95)
    found = estimate((a - b).reshape(shape))
    assert found.mean == pytest.approx((a - b).mean())
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.05 * (high - low))
    assert found.p == pytest.approx(known.pvalue, rel=0.2)


def test_many_values_are_scipys_bootstrap() -> None:
    values = np.random.default_rng(1).gamma(1.0, 1.0, 400)  # lopsided: not any symmetric interval
    known = stats.bootstrap((values,), np.mean, method="percentile", rng=2).confidence_interval
    found = estimate(values[None])
    assert (found.low, found.high) == pytest.approx(tuple(known), abs=0.01)


@pytest.mark.parametrize(
    ("spread", "seeds", "scenes"),
    [
        ((1.0, 0.0, 0.0), 3, 4),  # of seeds only: one network is better everywhere
        ((0.0, 1.0, 0.0), 3, 4),
        ((0.5, 1.0, 1.0), 3, 16),
    ],
)
def test_coverage(spread: tuple[float, float, float], seeds: int, scenes: int) -> None:
    """The true mean lies in 95 % of the intervals, whichever effect it is that varies."""
    rng = np.random.default_rng(3)
    trials, inside = 300, 0
    for _ in range(trials):
        of_seed = rng.normal(0, spread[0], (seeds, 1))
        of_scene = rng.normal(0, spread[1], (1, scenes))
        values = 1 + of_seed + of_scene + rng.normal(0, spread[2], (seeds, scenes))
        found = estimate(values, samples=500)
        assert found.low is not None and found.high is not None
        inside += found.low <= 1 <= found.high
    assert 0.93 < inside / trials < 0.995


@pytest.mark.parametrize("shape", [(3, 1), (1, 3)])
def test_three_values_by_hand(shape: tuple[int, int]) -> None:
    """Their bootstrap's 2.5 % quantile is the least of them: all draws are that 1 in 27 times."""
    wider = 4.302653 / 1.959964 * 1.5**0.5  # t(2) for the normal quantile, sqrt(n / (n - 1))
    found = estimate(np.array([0.0, 1, 2]).reshape(shape))
    assert (found.low, found.high) == pytest.approx((1 - wider, 1 + wider), abs=1e-5)


def test_drawing_pairs_would_be_too_sure() -> None:
    """Why seeds and scenes are drawn apart: here one seed of three is what speaks for the row."""
    values = np.array([[0.09] * 8, [0.0] * 8, [0.0] * 8])
    pairs = stats.bootstrap((values.ravel(),), np.mean, method="percentile", rng=0)
    assert pairs.confidence_interval.low > 0
    found = estimate(values)
    assert found.low is not None and found.low < 0


@pytest.mark.parametrize("shift", [-0.03, 0.004, 0.01, 0.02, 0.2])
def test_the_p_value_agrees_with_the_interval(shift: float) -> None:
    values = shift + np.random.default_rng(4).normal(0, 0.01, (3, 4))
    found = estimate(values)
    assert found.p is not None and found.low is not None and found.high is not None
    assert (found.p < 0.05) == (not found.low <= 0 <= found.high)
    if SMALLEST_P < found.p < 1:
        touching = estimate(values, confidence=1 - found.p)
        assert touching.low is not None and touching.high is not None
        assert min(abs(touching.low), abs(touching.high)) < 1e-3


def test_the_sign_turns_the_interval() -> None:
    values = np.random.default_rng(5).normal(0.01, 0.02, (3, 5))
    one, other = estimate(values, samples=50_000), estimate(-values, samples=50_000)
    assert one.low is not None and one.high is not None
    assert (other.low, other.high) == pytest.approx((-one.high, -one.low), abs=2e-3)


def test_no_difference_at_all() -> None:
    found = estimate(np.zeros((3, 4)))
    assert (found.mean, found.low, found.high) == (0, 0, 0)
    assert found.p == pytest.approx(1, abs=1e-3)


def test_one_pair_has_no_interval() -> None:
    found = estimate(np.array([[0.2]]))
    assert (found.mean, found.low, found.high, found.p) == (pytest.approx(0.2), None, None, None)


def test_the_same_at_every_call() -> None:
    values = np.random.default_rng(6).normal(0, 1, (3, 4))
    assert estimate(values) == estimate(values)


def test_holm() -> None:
    """The example by hand: the smallest times all, the next times one fewer, never falling."""
    found = holm([0.01, 0.04, None, 0.03, 0.005])
    assert found == pytest.approx([0.03, 0.06, None, 0.06, 0.02])
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert holm([None]) == [None]
