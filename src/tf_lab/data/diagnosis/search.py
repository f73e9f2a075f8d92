"""Which way to read a capture its matches speak for, and whether that is beyond doubt.

The way given is held against every other. One is named only if it is clearly better on the pairs
of images as a whole: pairs, not points, are drawn again in the bootstrap, because the points of a
pair share its pose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tf_lab.data.diagnosis.alternatives import (
    Alternative,
    focal,
    moved_centre,
    of_images,
    of_intrinsics,
    of_poses,
)
from tf_lab.data.diagnosis.evidence import SMALL, Evidence
from tf_lab.data.reading import ReadSettings
from tf_lab.errors import TFLabError

FOCAL_RANGE = (0.7, 1.4)
# How many times smaller the errors must be, for a change that is one of many and for a small one.
CLEARLY, SOMEWHAT = 1.5, 1.2
LEAST_FOCAL = 0.05  # a focal length nearer than this to what is stated is not told from it
LEAST_SHIFT = 0.03  # the same of the principal point, in image widths
IN_FRONT = 0.6  # of the points with parallax, at least
DRAWS = 500
SURE = 0.01  # at most so many draws may speak against it
STEPS = 3  # changes at once, at most
USABLE = 0.01  # error of usable poses, in image widths


@dataclass(frozen=True)
class Candidate:
    """A way to read the capture and its errors.

    Attributes:
        text: what is supposed.
        setting: "NAME=VALUE ...", empty as given.
        settings: with these.
        errors: [P] median Sampson distance of each pair, pixels; NaN without poses.
        evidence: the matches.
    """

    text: str
    setting: str
    settings: ReadSettings
    errors: np.ndarray
    evidence: Evidence

    @cached_property
    def in_front(self) -> float:
        """Share of points in front of both cameras; NaN where there is no parallax."""
        return self.evidence.in_front(self.evidence.geometry(self.settings))

    @property
    def error(self) -> float:
        """The median error, pixels."""
        known = self.errors[np.isfinite(self.errors)]
        return float(np.median(known)) if len(known) else float("inf")

    @property
    def possible(self) -> bool:
        """Whether what the images show lies before the cameras."""
        return not self.in_front < IN_FRONT


@dataclass(frozen=True)
class Found:
    """What the search gave.

    Attributes:
        given: the capture as it was read.
        best: the way to read it that is beyond doubt better, or as it was read.
        tried: all single changes and the steps to the best, by ascending error.
        same: settings of other changes that the images cannot tell from what was read.
        focal: the best focal length, as a factor on that of ``given``, with its interval (98 %);
            None: nothing explains the images well enough to say.
    """

    given: Candidate
    best: Candidate
    tried: list[Candidate]
    same: list[str]
    focal: tuple[float, float, float] | None


def search(evidence: Evidence, thorough: bool = True) -> Found:
    """Hold all ways to read a capture against its matches."""
    settings = evidence.settings
    given = _candidate(evidence, Alternative("as given", "", settings))
    best, tried = given, []
    steps = STEPS if thorough else 1
    for step in range(steps):
        options = [_candidate(evidence, a) for a in _alternatives(evidence, best.settings)]
        options.append(_best_focal(evidence, best)[0])
        if thorough:
            options.append(_best_centre(evidence, best))
        if not step:
            tried += options
        winner = _winner(evidence, best, options, CLEARLY if step else SOMEWHAT)
        if winner is None and not step and thorough and not explained(evidence, given):
            options = [_candidate(evidence, a) for a in _two_changes(evidence, settings)]
            winner = _winner(evidence, best, options)
        if winner is None:
            break
        best = _joined(best, winner) if step else winner
        if step:
            tried.append(best)
    same = [
        c.setting
        for c in tried
        if not _small_change(c) and not _better(evidence, given, c, 1.25) and c.possible
    ]
    tried.sort(key=lambda candidate: candidate.error)
    return Found(given, best, tried, same, _focal_of_given(evidence, given, best))


def _focal_of_given(
    evidence: Evidence, given: Candidate, best: Candidate
) -> tuple[float, float, float] | None:
    if not explained(evidence, best):
        return None
    changed = best.settings.focal_scale / given.settings.focal_scale
    factor, low, high = _best_focal(evidence, best)[1]
    return changed * factor, changed * min(low, factor), changed * max(high, factor)


def _alternatives(evidence: Evidence, settings: ReadSettings) -> Iterable[Alternative]:
    for of in (of_poses, of_images, of_intrinsics):
        yield from of(settings, evidence.given)


def _two_changes(evidence: Evidence, settings: ReadSettings) -> Iterable[Alternative]:
    """Pairs of changes of the poses, of which neither alone is any good."""
    for first in of_poses(settings, evidence.given):
        if first.setting.startswith("axes="):
            continue
        for second in of_poses(first.settings, evidence.given):
            if second.setting.startswith("axes="):
                text = f"{first.text}, {second.text}"
                yield Alternative(text, f"{first.setting} {second.setting}", second.settings)


def _candidate(evidence: Evidence, alternative: Alternative) -> Candidate:
    geometry = evidence.geometry(alternative.settings)
    return Candidate(
        alternative.text,
        alternative.setting,
        alternative.settings,
        evidence.errors(geometry),
        evidence,
    )


def _joined(first: Candidate, second: Candidate) -> Candidate:
    """Two steps as one."""
    return Candidate(
        f"{first.text}, {second.text}",
        f"{first.setting} {second.setting}",
        second.settings,
        second.errors,
        second.evidence,
    )


def _winner(
    evidence: Evidence, now: Candidate, options: list[Candidate], small: float = SOMEWHAT
) -> Candidate | None:
    """The option that is beyond doubt better than ``now``; of equals the first.

    A change of degree must make the errors ``small`` times smaller, any other `CLEARLY`.
    """
    better = [
        option
        for option in options
        if not _negligible(option, now, evidence)
        and _better(evidence, option, now, small if _small_change(option) else CLEARLY)
        and option.possible
    ]
    if not now.possible and not better:  # the same lines, but seen from the other side
        better = [o for o in options if o.possible and not _better(evidence, now, o, SOMEWHAT)]
    if not better:
        return None
    least = min(_mean(evidence, option) for option in better)
    return next(o for o in better if _mean(evidence, o) < least + np.log(1.1))


def usable(evidence: Evidence) -> float:
    """The error, pixels, that usable poses stay under: 1 % of the image's width."""
    return USABLE * evidence.capture.size[0]


def explained(evidence: Evidence, candidate: Candidate) -> bool:
    """Whether the errors are as small as those of usable poses."""
    return candidate.possible and candidate.error < usable(evidence)


def _mean(evidence: Evidence, candidate: Candidate) -> float:
    return float(np.nanmean(_logs(evidence, candidate.errors)))


def _logs(evidence: Evidence, errors: np.ndarray) -> np.ndarray:
    return np.log(errors + SMALL * evidence.capture.size[0] / 640)


def _better(evidence: Evidence, a: Candidate, b: Candidate, times: float) -> bool:
    """Whether a's errors are beyond doubt smaller than b's, and that many times."""
    gain = _logs(evidence, b.errors) - _logs(evidence, a.errors)
    gain = gain[np.isfinite(gain)]
    if len(gain) < 4 or gain.mean() < np.log(times):
        return False
    draws = np.random.default_rng(0).integers(0, len(gain), (DRAWS, len(gain)))
    return bool((gain[draws].mean(1) <= 0.5 * np.log(times)).mean() < SURE)


def _small_change(candidate: Candidate) -> bool:
    """Whether it is one of degree, of which smaller errors may be told."""
    name = candidate.setting.split()[-1].partition("=")[0] if candidate.setting else ""
    return name in ("focal_scale", "principal", "shift")


def _negligible(option: Candidate, now: Candidate, evidence: Evidence) -> bool:
    """Whether a change of degree is too small to be told from none."""
    factor = option.settings.focal_scale / now.settings.focal_scale
    if option.setting.startswith("focal_scale"):
        return bool(abs(np.log(factor)) < LEAST_FOCAL)
    value = option.settings.principal
    if option.setting.startswith("principal") and isinstance(value, tuple):
        return float(np.hypot(*value)) < LEAST_SHIFT * evidence.capture.size[0]
    return False


def _best_focal(evidence: Evidence, now: Candidate) -> tuple[Candidate, tuple[float, float, float]]:
    """The best focal length beside ``now``, and its factor with an interval of 98 %."""

    def curves_of(factors: np.ndarray) -> np.ndarray:
        rows = []
        for factor in factors:
            settings = replace(now.settings, focal_scale=now.settings.focal_scale * float(factor))
            rows.append(_logs(evidence, evidence.errors(evidence.geometry(settings))))
        curves = np.stack(rows)
        return np.asarray(curves[:, np.isfinite(curves).all(0)])

    factors = np.geomspace(*FOCAL_RANGE, 25)
    factors = factors[[_possible_focal(evidence, now, factor) for factor in factors]]
    curves = curves_of(factors)
    if not curves.size or len(factors) < 3:
        return now, (1.0, *FOCAL_RANGE)
    draws = np.random.default_rng(0).integers(0, curves.shape[1], (DRAWS, curves.shape[1]))
    sums = curves[:, draws].mean(2)
    low, high = np.quantile([_lowest(factors, sums[:, d]) for d in range(DRAWS)], [0.01, 0.99])
    near = _lowest(factors, curves.mean(1)) * np.geomspace(0.98, 1.02, 9)
    best = _lowest(near, curves_of(near).mean(1))
    return _candidate(evidence, focal(now.settings, best)), (best, float(low), float(high))


def _possible_focal(evidence: Evidence, now: Candidate, factor: float) -> bool:
    """Whether there are cameras of so many times the focal length: not of nearly half a turn."""
    try:
        evidence.geometry(focal(now.settings, 0.98 * factor).settings)
    except TFLabError:
        return False
    return True


def _lowest(factors: np.ndarray, curve: np.ndarray) -> float:
    """The lowest place of a sampled curve, by a parabola through the three lowest samples."""
    i = int(np.clip(np.argmin(curve), 1, len(curve) - 2))
    before, here, after = curve[i - 1 : i + 2]
    bend = before - 2 * here + after
    offset = 0.5 * (before - after) / bend if bend > 1e-12 else np.argmin(curve) - i
    step = np.log(factors[1] / factors[0])
    return float(factors[i] * np.exp(step * np.clip(offset, -1, 1)))


def _best_centre(evidence: Evidence, now: Candidate) -> Candidate:
    """The best principal point beside ``now``, within a tenth of the width."""
    reach = 0.1 * evidence.capture.size[0]
    steps = np.linspace(-reach, reach, 9)

    def cost(x: float, y: float) -> float:
        settings = moved_centre(now.settings, x, y).settings
        return float(np.nanmean(_logs(evidence, evidence.errors(evidence.geometry(settings)))))

    def along(of: Callable[[float], float], values: np.ndarray) -> float:
        return float(min(values, key=of))

    x = y = 0.0
    for span in (steps, steps / 4):
        x = along(lambda v, y=y: cost(v, y), x + span)  # type: ignore[misc]
        y = along(lambda v, x=x: cost(x, v), y + span)  # type: ignore[misc]
    return _candidate(evidence, moved_centre(now.settings, x, y))
