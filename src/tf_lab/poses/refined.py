"""A capture whose poses are adjusted to what its images show."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tf_lab.data.capture import Altered, Capture
from tf_lab.data.keyframes import select_keyframes
from tf_lab.errors import TFLabError
from tf_lab.poses.bundle import Deviations, adjust
from tf_lab.poses.tracks import follow

WORTH = 0.6  # of the sightings' error is left at most, or the given poses are kept


@dataclass(frozen=True)
class Change:
    """What refining did.

    Attributes:
        sightings: of followed points, in keyframes.
        before, after: median error of a sighting, pixels, by the given and the adjusted poses.
        kept: whether the given poses were kept, which explain the sightings nearly as well.
        turn: how far keyframes were turned, degrees, in the median; 0 if kept.
        move: and moved, metres.
    """

    sightings: int
    before: float
    after: float
    kept: bool
    turn: float
    move: float


class Refined(Altered):
    """A `Capture` with refined poses.

    Corners are followed through all frames; the keyframes' poses are adjusted so that they are
    seen where they are (`bundle.adjust`). A frame that is no keyframe moves as the keyframe before
    it. Good poses are left alone: an adjustment that explains little is not taken.

    Args:
        capture: the other.
        threshold: between keyframes, see `select_keyframes`.
        progress: called with (frames done, frames in all).
    """

    def __init__(
        self,
        capture: Capture,
        threshold: float,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        super().__init__(capture)
        given = np.asarray(capture.world_T_cam, np.float64)
        keyframes = select_keyframes(given, threshold)
        tracks = follow(_grey(capture, progress), set(keyframes))
        tracks = tracks._replace(frame=np.searchsorted(keyframes, tracks.frame))
        K, poses = capture.K[keyframes], given[keyframes]
        adjusted, (before, after) = adjust(tracks, K, poses, Deviations())
        kept = after > WORTH * before or not len(tracks.frame)
        corrections = np.tile(np.eye(4), (len(poses), 1, 1))
        if not kept:
            corrections = np.linalg.inv(poses) @ adjusted
        turns = Rotation.from_matrix(corrections[:, :3, :3]).magnitude()
        moves = np.linalg.norm(corrections[:, :3, 3], axis=1)
        self.change = Change(
            len(tracks.frame),
            before,
            after,
            kept,
            float(np.degrees(np.median(turns))),
            float(np.median(moves)),
        )
        last = np.searchsorted(keyframes, np.arange(len(given)), side="right") - 1
        self.world_T_cam = given @ corrections[last]


def _grey(
    capture: Capture, progress: Callable[[int, int], None] | None
) -> Iterator[tuple[int, np.ndarray]]:
    """The frames that can be read; whoever needs the others says that they can't."""
    total = len(capture.frames)
    for i in range(total):
        try:
            yield i, cv2.cvtColor(np.asarray(capture.image(i)), cv2.COLOR_RGB2GRAY)
        except TFLabError:
            continue
        finally:
            if progress is not None:
                progress(i + 1, total)
