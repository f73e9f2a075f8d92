"""A capture to a scene: frames at the training resolution with ground truth from their depth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch

from tf_lab.data import groundtruth, scene
from tf_lab.data.capture import Capture
from tf_lab.data.chunk_weights import Structure
from tf_lab.data.diagnosis import quick_warning
from tf_lab.data.groundtruth import GroundTruthSettings, write_groundtruth
from tf_lab.data.keyframes import KEYFRAME_DISTANCE, select_keyframes
from tf_lab.data.readers import open_capture
from tf_lab.data.reading import AS_STATED, ReadSettings
from tf_lab.data.resize import Resized
from tf_lab.data.scannet_splits import official_mesh, structure_labels
from tf_lab.data.scene import Frame, write_scene
from tf_lab.errors import TFLabError
from tf_lab.meshes.files import read_mesh
from tf_lab.support.hashes import hash_of

MANY_LOST = 0.2  # share of frames that makes a warning
VERSION = 5  # of what is made of a capture; a reader that gives others raises it


@dataclass(frozen=True)
class ImportSettings:
    """All that shapes the scene made of a capture.

    Attributes:
        width, height: of the stored frames, pixels.
        keyframe_distance: pose distance between stored frames (see `keyframes`); 0: all.
        read: how the source is read.
        groundtruth: how depth is fused.
    """

    width: int = 640
    height: int = 480
    keyframe_distance: float = KEYFRAME_DISTANCE
    read: ReadSettings = AS_STATED
    groundtruth: GroundTruthSettings = field(default_factory=GroundTruthSettings)

    @property
    def key(self) -> str:
        """A name for scenes of these settings, so that others never pass for them."""
        versions = [VERSION, scene.FORMAT, groundtruth.VERSION]
        return f"{self.width}x{self.height}-{hash_of([*versions, asdict(self)])}"


def import_capture(
    directory: Path,
    source: Path,
    settings: ImportSettings,
    memory: int,
    original: Capture | None = None,
    digest: str | None = None,
    check: bool = True,
    name: str | None = None,
) -> None:
    """Write a capture as a scene with ground truth (not atomic: give a temporary directory).

    Frames that cannot be read or have no depth are left out, and listed in the scene. What a quick
    check finds wrong with the cameras goes into its provenance.

    Args:
        directory: of the scene.
        source: the capture's folder or file.
        settings: of the scene.
        memory: bytes to take for depth fusion.
        original: the capture, if it is open already.
        digest: of its sources, for the scene's provenance.
        check: whether to look for cameras that are clearly wrong.
        name: of the scene; None: the capture's.

    Raises:
        TFLabError: nothing usable is left.
    """
    original = open_capture(source, settings.read) if original is None else original
    size = (settings.width, settings.height)
    capture = original if original.size == size else Resized(original, size)
    skipped = list(capture.skipped)
    found = [_many_lost(original), quick_warning(original, settings.read) if check else None]
    warning = "; ".join(filter(None, found)) or None
    provenance = {
        "source": source.name,
        "sources": digest,
        "settings": asdict(settings),
        "warning": warning,
    }
    made = write_scene(
        directory,
        _frames(capture, settings.keyframe_distance, skipped),
        provenance,
        name or capture.name,
        skipped,
        capture.source_T_world,
    )
    mesh = official_mesh(source)
    labels = structure_labels(source)
    world_T_source = np.linalg.inv(capture.source_T_world)
    structure = None
    if labels is not None:
        points = labels[0] @ world_T_source[:3, :3].T + world_T_source[:3, 3]
        structure = Structure(points, labels[1])
    write_groundtruth(
        made,
        made.groundtruth,
        settings.groundtruth,
        mesh=None if mesh is None else read_mesh(mesh).apply_transform(world_T_source),
        structure=structure,
        memory=memory,
        device="cuda" if torch.cuda.is_available() else "cpu",
    )


def _many_lost(capture: Capture) -> str | None:
    """How many frames are left out, and why most of them, where that is many."""
    lost, total = len(capture.skipped), len(capture.skipped) + len(capture.frames)
    if lost < MANY_LOST * total:
        return None
    reason, _ = Counter(map(reason_of, capture.skipped)).most_common(1)[0]
    return f"{lost} of {total} frames are left out, most as {reason}"


def _frames(capture: Capture, distance: float, skipped: list[str]) -> Iterator[Frame]:
    """The keyframes with image and depth; the others are added to ``skipped``."""
    for i in select_keyframes(capture.world_T_cam, distance):
        name = capture.frames[i]
        try:
            image, depth = capture.image(i), capture.depth(i)
        except TFLabError as error:
            skipped.append(f"{name}: {error}")
            continue
        if depth is None:
            skipped.append(f"{name}: no depth, of which the ground truth is made")
            continue
        yield Frame(name, image, capture.K[i], capture.world_T_cam[i], depth)


def reason_of(line: str) -> str:
    """The reason in "frame: reason", without the file that it names."""
    reason = line.split(": ", 1)[-1]
    return reason.split(": ", 1)[-1] if "/" in reason.split(": ", 1)[0] else reason
