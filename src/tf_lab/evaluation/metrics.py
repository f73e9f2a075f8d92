"""The paper's metrics on point sets: arrays in, a number out (paper, Sec. 4 "Metrics").

Distances inside are metres; accuracy, completeness and chamfer are returned in centimetres, as in
the paper's tables. Precision, recall and F-score are ratios in [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    import trimesh

THRESHOLD = 0.05  # metres: a point within it is a match
MAX_DISTANCE = 1.0  # metres: larger distances count as this
VISIBLE = 1 - 1e-5  # least interpolated visibility of a point that counts as observed


def distances(from_points: np.ndarray, to_points: np.ndarray) -> np.ndarray:
    """Distance of each point to the nearest of another set, capped at `MAX_DISTANCE`.

    Args:
        from_points: [P, 3] metres.
        to_points: [Q, 3] metres; may be empty, then every distance is the cap.

    Returns:
        float64 [P], metres.
    """
    return nearest(from_points, to_points)[0]


def nearest(from_points: np.ndarray, to_points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `distances`, and the index [P] of the nearest point: Q where there is none in reach."""
    if len(from_points) == 0 or len(to_points) == 0:
        return np.full(len(from_points), MAX_DISTANCE), np.zeros(len(from_points), int)
    found, index = cKDTree(to_points).query(
        from_points,
        distance_upper_bound=MAX_DISTANCE,
        workers=-1,  # all cores
    )
    return np.minimum(found, MAX_DISTANCE), index  # beyond the bound the tree answers infinity


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


@dataclass(frozen=True)
class Comparison:
    """A reconstruction beside the ground truth of its scene: what every metric gets.

    Attributes:
        points: [P, 3] samples of the predicted surface, metres; at least one.
        visible: bool [P], see `visibility`.
        truth: [G, 3] the vertices of the ground-truth mesh, metres; at least one.
        mesh: the prediction, metres; a point cloud has no faces; None: only points are known.
        faces: [P] the face of ``mesh`` that each point lies on; None: it has none.
        truth_mesh: the ground truth, metres; None: only points are known.

    Raises:
        ValueError: there is no predicted point, or the ground truth has none.
    """

    points: np.ndarray
    visible: np.ndarray
    truth: np.ndarray
    mesh: trimesh.Trimesh | None = None
    faces: np.ndarray | None = None
    truth_mesh: trimesh.Trimesh | None = None

    def __post_init__(self) -> None:
        if len(self.points) == 0 or len(self.truth) == 0:
            which = "ground truth" if len(self.points) else "prediction"
            raise ValueError(f"the {which} has no point")

    @cached_property
    def counted(self) -> np.ndarray:
        """Bool [P]: the points that accuracy and precision are of, the visible ones.

        Completing the scene beyond the ground truth costs nothing there; completeness and recall
        see every point. If none is visible, all count, as in the authors' script: otherwise such
        a prediction would get the precision of an empty one.
        """
        return self.visible if self.visible.any() else np.ones(len(self.points), bool)

    @cached_property
    def to_truth(self) -> np.ndarray:
        """Distances of the counted points to the ground truth, metres, capped."""
        return distances(self.points[self.counted], self.truth)

    @cached_property
    def to_prediction(self) -> np.ndarray:
        """Distances [G] of the ground-truth points to the prediction, metres, capped."""
        return distances(self.truth, self.points)


def accuracy(found: Comparison) -> float:
    """Mean distance of the prediction to the ground truth, cm."""
    return 100 * float(found.to_truth.mean())


def completeness(found: Comparison) -> float:
    """Mean distance of the ground truth to the prediction, cm."""
    return 100 * float(found.to_prediction.mean())


def chamfer(found: Comparison) -> float:
    """Mean of accuracy and completeness, cm."""
    return (accuracy(found) + completeness(found)) / 2


def precision(found: Comparison) -> float:
    """Share of the prediction that is within 5 cm of the ground truth."""
    return float((found.to_truth <= THRESHOLD).mean())


def recall(found: Comparison) -> float:
    """Share of the ground truth that is within 5 cm of the prediction."""
    return float((found.to_prediction <= THRESHOLD).mean())


def fscore(found: Comparison) -> float:
    """Harmonic mean of precision and recall; 0 if both are 0."""
    prec, rec = precision(found), recall(found)
    return 2 * prec * rec / (prec + rec) if prec + rec > 0 else 0.0
