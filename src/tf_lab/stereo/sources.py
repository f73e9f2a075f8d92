"""Which views a view is compared with."""

from __future__ import annotations

import numpy as np

SAME_WAY = 0.7  # cosine of 45 degrees


def choose_sources(
    world_T_cam: np.ndarray, i: int, count: int, baseline: tuple[float, float, float]
) -> list[int]:
    """The views to compare view i with: a fair baseline, and looking the same way.

    Those come first whose baseline is nearest to the best one (as a factor); of these, those whose
    optical axis is within 45 degrees.

    Args:
        world_T_cam: poses [N, 4, 4] of all that there are.
        i: the view.
        count: how many sources at most.
        baseline: between two cameras, metres: the least, the most, and what is best.

    Returns:
        Their numbers, the best first; none if no view is fair.
    """
    low, high, best = baseline
    length = np.linalg.norm(world_T_cam[:, :3, 3] - world_T_cam[i, :3, 3], axis=-1)
    same_way = world_T_cam[:, :3, 2] @ world_T_cam[i, :3, 2]
    fair = (length >= low) & (length <= high) & (same_way > SAME_WAY)
    cost = np.abs(np.log(np.maximum(length, 1e-6) / best)) + 2 * (1 - same_way)
    order = np.argsort(np.where(fair, cost, np.inf), kind="stable")
    return [int(j) for j in order[: min(count, int(fair.sum()))]]
