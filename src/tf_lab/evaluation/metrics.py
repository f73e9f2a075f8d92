"""Reconstruction metrics on point sets: arrays in, numbers out (paper, Sec. 4 "Metrics").

Distances inside are metres; the reported ``acc``, ``compl`` and ``chamfer`` are centimetres, as in
the paper's tables. ``prec``, ``recall`` and ``fscore`` are ratios in [0, 1].
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

KEYS = ("acc", "compl", "chamfer", "prec", "recall", "fscore")
THRESHOLD = 0.05  # metres: a point within it is a match
MAX_DISTANCE = 1.0  # metres: larger distances count as this
VISIBLE = 1 - 1e-5  # least interpolated visibility of a point that counts as observed

Metrics = dict[str, float]


def distances(from_points: np.ndarray, to_points: np.ndarray, workers: int = -1) -> np.ndarray:
    """Distance of each point to the nearest of another set, capped at `MAX_DISTANCE`.

    Args:
        from_points: [P, 3] metres.
        to_points: [Q, 3] metres; may be empty, then every distance is the cap.
        workers: threads of the search, -1 for all cores.

    Returns:
        float64 [P], metres.
    """
    if len(from_points) == 0 or len(to_points) == 0:
        return np.full(len(from_points), MAX_DISTANCE)
    nearest, _ = cKDTree(to_points).query(
        from_points, distance_upper_bound=MAX_DISTANCE, workers=workers
    )
    return np.minimum(nearest, MAX_DISTANCE)  # beyond the bound the tree answers infinity


def visibility(
    points: np.ndarray, occlusion_mask: np.ndarray, world2grid: np.ndarray
) -> np.ndarray:
    """Whether the ground truth ever observed the space around each point: bool [P].

    Visibility (1 - occlusion mask) is interpolated trilinearly and is 0 outside the grid, so a
    point counts only where all voxels that surround it were observed.

    Args:
        points: [P, 3] world points, metres.
        occlusion_mask: [X, Y, Z], 1 where never observed, 0 where observed.
        world2grid: [4, 4], world metres to continuous voxel coordinates (integers at centres).
    """
    index = points @ world2grid[:3, :3].T + world2grid[:3, 3]
    # "grid-constant" fades to zero beyond the outermost centres, so that rounding on the border
    # of the grid never turns a visible point into an outside one.
    seen = map_coordinates(
        1 - occlusion_mask.astype(np.float32), index.T, order=1, mode="grid-constant", cval=0.0
    )
    return seen >= VISIBLE


def fscore(precision: float, recall: float) -> float:
    """Harmonic mean of precision and recall; 0 if both are 0."""
    total = precision + recall
    return 2 * precision * recall / total if total > 0 else 0.0


def empty_metrics() -> Metrics:
    """The score of a missing or empty reconstruction: worst distances, precision 1, recall 0."""
    worst = 100 * MAX_DISTANCE
    return dict(zip(KEYS, (worst, worst, worst, 1.0, 0.0, 0.0), strict=True))


def reconstruction_metrics(
    predicted_points: np.ndarray,
    visible: np.ndarray,
    gt_points: np.ndarray,
    threshold: float = THRESHOLD,
    workers: int = -1,
) -> Metrics:
    """Accuracy, completeness, chamfer (cm), precision, recall and F-score of a point set.

    Unobserved predicted points leave accuracy and precision only: completing the scene beyond the
    ground truth costs nothing there, and completeness and recall still see every point. If no
    point at all is visible, all are kept, as the authors' script does: otherwise such a
    prediction would get the precision of an empty one.

    Args:
        predicted_points: [P, 3] samples of the predicted surface, metres; may be empty.
        visible: bool [P], see `visibility`.
        gt_points: [G, 3] vertices of the ground-truth mesh, metres; at least one.
        threshold: match distance, metres.
        workers: threads of the search, -1 for all cores.

    Raises:
        ValueError: the ground truth has no point.
    """
    if len(gt_points) == 0:
        raise ValueError("the ground truth has no point")
    if len(predicted_points) == 0:
        return empty_metrics()
    counted = predicted_points[visible] if visible.any() else predicted_points
    to_gt = distances(counted, gt_points, workers)
    to_prediction = distances(gt_points, predicted_points, workers)
    acc, compl = 100 * float(to_gt.mean()), 100 * float(to_prediction.mean())
    prec = float((to_gt <= threshold).mean())
    recall = float((to_prediction <= threshold).mean())
    chamfer = (acc + compl) / 2
    return dict(zip(KEYS, (acc, compl, chamfer, prec, recall, fscore(prec, recall)), strict=True))


def mean_metrics(scenes: Iterable[Mapping[str, float]]) -> Metrics:
    """Mean of each metric over scenes; so the mean F-score is not the F-score of the means."""
    rows = list(scenes)
    return {key: float(np.mean([row[key] for row in rows])) for key in KEYS}
