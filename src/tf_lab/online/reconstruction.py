"""A capture to a mesh: what the commands, and the tests of a training, do."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import trimesh

from tf_lab.data.capture import Capture
from tf_lab.data.keyframes import select_keyframes
from tf_lab.errors import TFLabError
from tf_lab.network.network import Network
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.support.memory import telling_no_memory

LESS = (
    "give online.maps_budget=2 (GiB of feature maps that are kept), online.precision=bfloat16, or "
    "a smaller online.batch"
)

log = logging.getLogger(__name__)


@dataclass
class Reconstruction:
    """What came of a capture.

    Attributes:
        mesh: metres.
        keyframes: the frames that it was made of, in the order in which they were added.
        skipped: why which frame could not be read.
        online: what it was made by, with its view sets; None: by a method without.
    """

    mesh: trimesh.Trimesh
    keyframes: list[int]
    skipped: list[str]
    online: Reconstructor | None = None


def reconstruct(
    network: Network,
    capture: Capture,
    settings: ReconstructionSettings,
    progress: Callable[[int, int], None] | None = None,
    color: bool = True,
) -> Reconstruction:
    """Reconstruct a capture from its keyframes; frames that can't be read are skipped.

    Args:
        network: in evaluation mode.
        capture: posed images.
        settings: test-time settings.
        progress: called with (frames done, frames in all).
        color: whether the mesh is painted.

    Raises:
        TFLabError: no frame can be read, or memory has run out.
    """
    with telling_no_memory(capture.name, LESS):
        return _reconstruct(network, capture, settings, progress, color)


def _reconstruct(
    network: Network,
    capture: Capture,
    settings: ReconstructionSettings,
    progress: Callable[[int, int], None] | None,
    color: bool,
) -> Reconstruction:
    keyframes = select_keyframes(capture.world_T_cam, settings.keyframe_distance)
    online = Reconstructor(network, settings)
    used, skipped = [], []
    for done, i in enumerate(keyframes, start=1):
        try:
            online.add_frame(capture.image(i), capture.K[i], capture.world_T_cam[i])
            used.append(i)
        except TFLabError as error:
            log.warning("frame %s skipped: %s", capture.frames[i], error)
            skipped.append(f"{capture.frames[i]}: {error}")
        if progress is not None:
            progress(done, len(keyframes))
    if not used:
        raise TFLabError(
            f"{capture.name}: none of the {len(keyframes)} keyframes can be read; the first: "
            f"{skipped[0]}"
        )
    return Reconstruction(online.mesh(color=color), used, skipped, online)
