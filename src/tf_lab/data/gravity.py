"""From a source's world frame to ours, whose z axis points up.

The direction of gravity ("down", in the source's frame) comes from the capture's
``gravity-direction.txt``, or else from the user, or else from the source's format, or else from how
people hold cameras.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from tf_lab.data.origin import local_origin
from tf_lab.errors import TFLabError
from tf_lab.geometry import rotation_between
from tf_lab.support.text import read_numbers

DIRECTION_FILE = "gravity-direction.txt"
# Below this second moment of the camera x axes (a spread of some 8 degrees) they hardly vary.
MIN_SPREAD = 0.02
# The horizontal spread must clearly exceed the vertical one, which is the roll of the hand.
MIN_RATIO = 3.0

logger = logging.getLogger(__name__)


def find_down(
    directory: Path,
    world_T_cam: np.ndarray,
    given: Sequence[float] | None = None,
    stated: Sequence[float] | None = None,
) -> np.ndarray:
    """The unit direction of gravity [3] in the world of the poses [N, 4, 4]; logs where it is from.

    Args:
        directory: the capture's; its `DIRECTION_FILE` is used first.
        world_T_cam: for the estimate, where nothing else says.
        given: the user's, used where there is no file.
        stated: by the source's format, used where nobody says otherwise.

    Raises:
        TFLabError: the file or the given direction is not three numbers with a direction.
    """
    path = directory / DIRECTION_FILE
    if path.exists():
        if given is not None:
            logger.warning("%s is used, not the given gravity; remove it to use that", path)
        down = _unit(read_numbers(path, "it holds three numbers"), str(path))
        source = DIRECTION_FILE
    elif given is not None:
        down, source = _unit(given, "gravity"), "as given"
    elif stated is not None:
        down, source = _unit(stated, "gravity"), "as the format states"
    else:
        down, source = estimate_down(world_T_cam), "estimated from the camera poses"
    logger.info("%s: gravity %s (%s)", directory, np.array2string(down, precision=4), source)
    return down


def estimate_down(world_T_cam: np.ndarray) -> np.ndarray:
    """The likely direction of gravity, a unit vector [3], from camera poses [N, 4, 4].

    People hold cameras level: the cameras' x axes are nearly horizontal, so the vertical is the
    direction most orthogonal to all of them, and image rows run down. Where the x axes hardly vary
    (the camera never turned) that leaves a plane of directions, and the mean of the image-down
    axes is the best guess; it is off by the cameras' mean pitch. Portrait captures are not
    recognised.

    Raises:
        TFLabError: the poses contradict each other so much that no direction follows.
    """
    right, image_down = world_T_cam[:, :3, 0], world_T_cam[:, :3, 1].mean(0)
    moments, directions = np.linalg.eigh(right.T @ right / len(right))  # ascending
    if moments[1] < max(MIN_SPREAD, MIN_RATIO * moments[0]):
        logger.warning("the cameras hardly turn: gravity is only as good as they are level")
        return _unit(image_down, "the mean of the cameras' image-down axes")
    vertical = directions[:, 0]
    return vertical if vertical @ image_down >= 0 else -vertical


def align(world_T_cam: np.ndarray, down: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn poses [N, 4, 4] by the smallest rotation that takes ``down`` [3] to -z.

    Cameras far from the origin are moved near it, too (see `local_origin`).

    Returns:
        The poses in the z-up world, and source_T_world [4, 4], the way back.
    """
    minus_z = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)
    world_R_source = rotation_between(torch.as_tensor(down, dtype=torch.float64), minus_z).numpy()
    source_T_world = np.eye(4)
    source_T_world[:3, :3] = world_R_source.T
    source_T_world[:3, 3] = origin = local_origin(world_T_cam)
    upright = world_T_cam.copy()
    upright[:, :3, 3] -= origin
    upright[:, :3] = world_R_source @ upright[:, :3]
    if origin.any():
        logger.info("the cameras are far from the origin of their world: ours is at %s", origin)
    return upright, source_T_world


def _unit(direction: Sequence[float] | np.ndarray, origin: str) -> np.ndarray:
    vector = np.asarray(direction, np.float64)
    length = np.linalg.norm(vector)
    if vector.shape != (3,) or not np.isfinite(length) or length < 1e-6:
        raise TFLabError(
            f"{origin}: {vector.tolist()} is no direction; give three numbers, the direction of "
            "gravity (down) in the world of the poses, for example [0, 0, -1]"
        )
    return vector / length
