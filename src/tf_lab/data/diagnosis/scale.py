"""Whether poses and depth are in metres: triangulated depth against depth maps, or against rooms.

Epipolar geometry does not change with the unit of the poses, so that it needs a second witness.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tf_lab.data.capture import usual_depth_scale
from tf_lab.data.diagnosis.evidence import Evidence
from tf_lab.data.diagnosis.search import Candidate
from tf_lab.errors import TFLabError

LEAST_POINTS = 8  # of a pair, with parallax and depth
TOLERANCE = 1.15  # factor; wrong focal lengths and unregistered depth stay below it
# Depth of what indoor cameras see, metres: the median over a capture, and what is possible.
USUAL, POSSIBLE = 2.0, (0.25, 15.0)
UNITS = (1e-3, 1e-2, 0.0254, 0.1, 0.2, 0.3048, 0.5, 2.0, 5.0, 10.0, 100.0, 1000.0)


@dataclass(frozen=True)
class Scale:
    """What the depth says of the unit of the poses.

    Attributes:
        seen: median triangulated depth, in metres if the poses are; NaN: no parallax.
        measured: median of the depth maps at the same points, metres; NaN: there are none.
        factor: measured over triangulated depth; NaN without depth.
        spread: how far pairs differ from it: the factor that covers half of them.
        setting: that puts it right; empty: nothing to put right.
        certain: whether depth says so, and not only what rooms are like.
    """

    seen: float
    measured: float
    factor: float
    spread: float
    setting: str
    certain: bool


def find_scale(evidence: Evidence, best: Candidate) -> Scale:
    """Compare depths of the matches under the best way to read the capture."""
    z_a, z_b = evidence.depths(evidence.geometry(best.settings))
    good = (z_a > 0) & (z_b > 0)
    triangulated = np.where(good, z_a, np.nan)
    if good.sum() < 2 * LEAST_POINTS:
        return Scale(np.nan, np.nan, np.nan, np.nan, "", False)
    seen = float(np.nanmedian(triangulated))
    ratios, measured = [], []
    for row, pair in enumerate(evidence.pairs):
        use = np.flatnonzero(good[row])
        if len(use) < LEAST_POINTS:
            continue
        depth = _depth_at(evidence, pair.i, pair.a[use[use < len(pair.a)]])
        known = depth > 0
        if known.sum() >= LEAST_POINTS:
            ratios.append(np.median(depth[known] / triangulated[row, use][known]))
            measured += depth[known].tolist()
    if len(ratios) < 3:
        setting = _plausible(seen, best.settings.scale)
        return Scale(seen, np.nan, np.nan, np.nan, setting, False)
    logs = np.log(ratios)
    factor = float(np.exp(np.median(logs)))
    spread = float(np.exp(np.median(np.abs(logs - np.median(logs)))))
    setting = ""
    if abs(np.log(factor)) > np.log(TOLERANCE) and abs(np.log(factor)) > 2 * np.log(spread):
        setting = _mend(evidence, factor, float(np.median(measured)), best.settings.scale)
    return Scale(seen, float(np.median(measured)), factor, spread, setting, True)


def _depth_at(evidence: Evidence, frame: int, points: np.ndarray) -> np.ndarray:
    """The depth map's readings at pixels [M, 2] of a frame; 0 where there is none."""
    try:
        depth = evidence.capture.depth(frame)
    except TFLabError:
        depth = None
    if depth is None:
        return np.zeros(len(points))
    height, width = depth.shape
    column, row = np.round(points).astype(int).T
    return depth[row.clip(0, height - 1), column.clip(0, width - 1)]


def _mend(evidence: Evidence, factor: float, measured: float, scale: float | None) -> str:
    """Which of both is to be mended: that whose values no room has."""
    if abs(np.log(measured / USUAL)) <= abs(np.log(measured / factor / USUAL)):
        return f"scale={_round((scale or 1.0) * factor):g}"
    stated = evidence.settings.depth_scale
    if stated is None:
        stated = _depth_scale(evidence)
    return "" if stated is None else f"depth_scale={_round(stated * factor):g}"


def _depth_scale(evidence: Evidence) -> float | None:
    """Units per metre of the depth maps; None where their layout has no other."""
    depths: list[Any] = [frame.depth for frame in evidence.given.frames if frame.depth]
    for depth in depths if depths and hasattr(depths[0], "scale") else []:
        if depth.scale is not None:
            return float(depth.scale)
        with contextlib.suppress(TFLabError):  # one that cannot be read says nothing of the others
            return usual_depth_scale(Path(str(depth)))
    return None


def _plausible(seen: float, scale: float | None) -> str:
    """The unit in which rooms are as deep as what was seen."""
    if POSSIBLE[0] <= seen <= POSSIBLE[1]:
        return ""
    unit = min(UNITS, key=lambda unit: abs(np.log(seen * unit / USUAL)))
    return f"scale={(scale or 1.0) * unit:g}"


def _round(value: float) -> float:
    """A power of ten or half of one where it is meant, else three digits."""
    power = 10.0 ** np.floor(np.log10(value))
    for simple in (power, 2 * power, 5 * power, 10 * power):
        if abs(np.log(value / simple)) < 0.06:
            return float(simple)
    return float(f"{value:.3g}")
