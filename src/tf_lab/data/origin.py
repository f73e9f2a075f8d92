"""Where the cameras of a capture are: a room's size apart, and near the origin of its world.

Everything after the readers computes in single precision, which far from the origin (UTM,
geocentric coordinates) is worth decimetres; and metres are what most formats mean and not all users
write.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from tf_lab.errors import TFLabError

FAR = 100.0  # metres; nearer, single precision is worth hundredths of a millimetre
WIDE = 100.0  # metres between the cameras of a capture: more than most buildings
TOO_WIDE = 500.0  # no walk with a camera, but millimetres of a small one
MAJORITY = (10, 90)  # percentiles: a few wild poses say nothing

logger = logging.getLogger(__name__)


def local_origin(world_T_cam: np.ndarray) -> np.ndarray:
    """Where [3] the origin should be for cameras [N, 4, 4]: amid them, if they are far from theirs.

    In whole metres; zero for cameras within `FAR` metres.
    """
    centre = np.median(world_T_cam[:, :3, 3], axis=0)
    if np.abs(centre).max() <= FAR:
        return np.zeros(3)
    return np.asarray(np.round(centre))


def check_extent(path: Path, world_T_cam: np.ndarray) -> None:
    """Say so where poses [N, 4, 4] that nobody gave a scale for can hardly be in metres.

    Raises:
        TFLabError: the cameras are `TOO_WIDE` apart.
    """
    low, high = np.percentile(world_T_cam[:, :3, 3], MAJORITY, axis=0)
    extent = (high - low).max()
    if extent <= WIDE:
        return
    message = (
        f"{path}: its cameras are {extent:,.0f} m apart, if the poses are in metres; give "
        "scale=0.001 if they are in millimetres, scale=0.01 for centimetres, scale=1 for metres"
    )
    if extent > TOO_WIDE:
        raise TFLabError(message)
    logger.warning(message)
