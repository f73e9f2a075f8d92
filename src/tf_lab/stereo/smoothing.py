"""Semi-global matching (Hirschmueller 2008): costs made smooth along scan lines."""

from __future__ import annotations

import numpy as np

EDGE = 12.0  # a step of grey (0..1) by 1 / 12 halves what a change of depth costs
FAR_TOO_MUCH = np.float32(1e9)


def aggregate(costs: np.ndarray, grey: np.ndarray, small: float, large: float) -> np.ndarray:
    """Costs summed over the best paths to each pixel from the four sides.

    Args:
        costs: float32 [P, H, W] of planes at pixels.
        grey: float32 [H, W] in 0..1; where it steps, a change of depth costs less.
        small: what a change by one plane costs.
        large: what a larger change costs; never less than ``small``.

    Returns:
        float32 [P, H, W].
    """
    rows = np.ascontiguousarray(costs.transpose(1, 2, 0))  # [H, W, P]
    columns = np.ascontiguousarray(costs.transpose(2, 1, 0))
    down, right = (_both_ways(x, g, small, large) for x, g in ((rows, grey), (columns, grey.T)))
    return (down + right.transpose(1, 0, 2)).transpose(2, 0, 1)


def _both_ways(costs: np.ndarray, grey: np.ndarray, small: float, large: float) -> np.ndarray:
    there = _path(costs, grey, small, large)
    back = _path(costs[::-1], grey[::-1], small, large)[::-1]
    return there + back


def _path(costs: np.ndarray, grey: np.ndarray, small: float, large: float) -> np.ndarray:
    """Costs [N, M, P] of the best paths along the first axis that end at each pixel and plane."""
    steps = np.abs(np.diff(grey, axis=0))
    jump = np.maximum(large / (1 + EDGE * steps), small).astype(np.float32)[..., None]
    total = np.empty_like(costs)
    total[0] = costs[0]
    beside = np.full((costs.shape[1], costs.shape[2] + 2), FAR_TOO_MUCH, np.float32)
    for n in range(1, len(costs)):
        before = total[n - 1]
        least = before.min(1, keepdims=True)
        beside[:, 1:-1] = before
        one = np.minimum(beside[:, :-2], beside[:, 2:]) + np.float32(small)
        reached = np.minimum(np.minimum(before, one), least + jump[n - 1])
        total[n] = costs[n] + reached - least
    return total
