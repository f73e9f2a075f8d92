"""How wrong poses are among each other."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def between(poses: np.ndarray, others: np.ndarray) -> tuple[float, float]:
    """Median errors of the way from each camera to the next: degrees, metres."""
    steps = [np.linalg.inv(p[:-1]) @ p[1:] for p in (poses, others)]
    off = np.linalg.inv(steps[0]) @ steps[1]
    turn = np.degrees(Rotation.from_matrix(off[:, :3, :3]).magnitude())
    return float(np.median(turn)), float(np.median(np.linalg.norm(off[:, :3, 3], axis=1)))
