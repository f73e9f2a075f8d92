"""Whether the cameras move, by their poses alone: without it nothing can be triangulated."""

from __future__ import annotations

import numpy as np

from tf_lab.data.diagnosis.evidence import Evidence

NONE = 1e-4  # metres between the places of cameras that do not move
LITTLE = 0.05  # metres: less than a hand moves in a walk through a room
TURN = 1e-4  # between the elements of rotations that are the same
MOVED = 0.01  # median motion of the images' points, in image widths


def standstill(world_T_cam: np.ndarray) -> str:
    """Why nothing can be made of cameras [N, 4, 4], which stay where they are; empty: they move."""
    count = len(world_T_cam)
    if count < 2 or _span(world_T_cam) > NONE:
        return ""
    if np.ptp(world_T_cam[:, :3, :3], axis=0).max() < TURN:
        return f"the camera does not move: all {count} poses are the same"
    return (
        f"the camera only turns: all {count} poses are at one place, from which nothing can be "
        "triangulated"
    )


def little_motion(world_T_cam: np.ndarray) -> str:
    """What is odd about cameras [N, 4, 4] that hardly move; empty: they move."""
    span = _span(world_T_cam)
    if len(world_T_cam) < 2 or span > LITTLE:
        return ""
    return (
        f"all cameras are within {1000 * span:.2g} mm, if the poses are in metres; else give "
        "scale=METRES_PER_UNIT"
    )


def images_move(evidence: Evidence) -> bool:
    """Whether the images show that the camera moves, whatever the poses say."""
    if not evidence.pairs:
        return False
    motion = np.linalg.norm(evidence.a - evidence.b, axis=-1)
    return float(np.nanmedian(motion)) > MOVED * evidence.capture.size[0]


def _span(world_T_cam: np.ndarray) -> float:
    """The largest extent, along x, y or z, of where cameras are."""
    return float(np.ptp(world_T_cam[:, :3, 3], axis=0).max())
