"""How sure a difference of scores is, given a few seeds and a few scenes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SAMPLES = 10_000
SMALLEST_P = 1e-4  # a p-value below it would rest on less than one sample


@dataclass(frozen=True)
class Estimate:
    """A mean; the interval it lies in and the p-value of zero are None for a single number."""

    mean: float
    low: float | None = None
    high: float | None = None
    p: float | None = None


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """p-values corrected for their number (Holm, 1979): some is below a level by chance that often.

    Those that are None do not count.
    """
    known = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    corrected: list[float | None] = [None] * len(p_values)
    least = 0.0
    for rank, (p, i) in enumerate(known):
        least = max(least, min(1.0, (len(known) - rank) * p))
        corrected[i] = least
    return corrected


def deviation(values: np.ndarray) -> float | None:
    """Standard deviation of repetitions [N] (with N - 1); None for fewer than two."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else None


def estimate(
    differences: np.ndarray, confidence: float = 0.95, samples: int = SAMPLES, seed: int = 0
) -> Estimate:
    """Mean, bootstrap interval and two-sided p-value of paired differences.

    Seeds and scenes are crossed: every seed's network meets the same scenes. A seed moves all its
    scenes together, and a scene all its seeds, so that the pairs are not independent: drawing pairs
    would give too narrow an interval. Therefore seeds and scenes are drawn with replacement,
    independently of each other (the pigeonhole bootstrap of Owen, 2007), and the interval speaks
    of new seeds on new scenes. A bootstrap of n values is still too narrow by sqrt((n - 1) / n) and
    by the normal quantile in place of Student's (Hesterberg, 2015), which at three seeds matters
    most; the drawn effects of seeds and of scenes are widened by just that. So a 95 % interval of
    three seeds covers the truth 94 to 99 times in a hundred, whichever effect is the largest, where
    a plain one may do so only 75 times (by simulation, see the tests). With one seed the interval
    speaks of scenes only, with one scene of seeds only.

    The p-value is one minus the confidence at which the interval touches zero, so that the two
    never disagree. (Permuting signs could not tell anything: three seeds have eight patterns.)

    Args:
        differences: [seeds, scenes] of a score, paired.
        confidence: of the interval.
        samples: bootstrap samples.
        seed: of the bootstrap.

    Returns:
        The estimate; without interval and p-value if there is one seed and one scene.
    """
    mean = float(differences.mean())
    if differences.size == 1:
        return Estimate(mean)
    drawn = _Bootstrap(differences, samples, seed)
    low, high = drawn.interval(1 - confidence)
    return Estimate(mean, low, high, drawn.p_value())


class _Bootstrap:
    """Resampled effects of seeds, of scenes, and of what is neither."""

    def __init__(self, differences: np.ndarray, samples: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.sizes = seeds, scenes = differences.shape
        self.mean = float(differences.mean())
        by_seed = differences.mean(1) - self.mean
        by_scene = differences.mean(0) - self.mean
        rest = differences - self.mean - by_seed[:, None] - by_scene
        seed_weights = rng.multinomial(seeds, np.full(seeds, 1 / seeds), samples) / seeds
        scene_weights = rng.multinomial(scenes, np.full(scenes, 1 / scenes), samples) / scenes
        self.of_seeds = seed_weights @ by_seed
        self.of_scenes = scene_weights @ by_scene
        self.of_rest = ((seed_weights @ rest) * scene_weights).sum(1)

    def interval(self, alpha: float) -> tuple[float, float]:
        """Bounds that leave out ``alpha``."""
        widths = (_widening(size, alpha) for size in self.sizes)
        drawn = next(widths) * self.of_seeds + next(widths) * self.of_scenes + self.of_rest
        low, high = self.mean + np.quantile(drawn, [alpha / 2, 1 - alpha / 2])
        return float(low), float(high)

    def p_value(self) -> float:
        """The largest ``alpha`` at which the interval includes zero."""
        outside, inside = 1.0, SMALLEST_P
        low, high = self.interval(inside)
        if not low <= 0 <= high:
            return SMALLEST_P
        for _ in range(30):
            middle = math.sqrt(outside * inside)
            low, high = self.interval(middle)
            if low <= 0 <= high:
                inside = middle
            else:
                outside = middle
        return inside


def _widening(size: int, alpha: float) -> float:
    """By how much a bootstrap of so many values is too narrow."""
    from scipy.special import ndtri, stdtrit  # slow to import; errors need not wait for it

    if size == 1:
        return 1.0
    quantile = 1 - alpha / 2
    student = stdtrit(size - 1, quantile) / ndtri(quantile) if alpha < 1 else 1.0
    return float(student) * math.sqrt(size / (size - 1))
