"""Live viewing without a page: frames a second, how old the mesh gets, whether memory stays.

A session plays as for the viewer, as fast as it goes; what is told to the page is encoded as it is
for a page, and thrown away.
"""

from __future__ import annotations

import time

import numpy as np
import trimesh

from tf_lab.benchmarks.memory import resident_memory
from tf_lab.data.capture import Capture
from tf_lab.meshes.glb import glb_of
from tf_lab.network.network import Network
from tf_lab.online.kept import Pick
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.online.surface import Chunk
from tf_lab.viewer.session import Session, State

ROUNDS = 5  # of other colours and back, after the last frame


class Watcher:
    """A listener that notes when what was told."""

    def __init__(self) -> None:
        self.meshes: list[float] = []
        self.sent = 0

    def cleared(self) -> None:
        """All starts from nothing."""

    def framed(self, source: int) -> None:
        """A frame was added."""

    def meshed(self, chunk: Chunk, piece: trimesh.Trimesh | None, colors: np.ndarray) -> None:
        """A chunk's surface changed."""
        if piece is not None:
            shown = trimesh.Trimesh(
                piece.vertices, piece.faces, vertex_colors=colors, process=False
            )
            self.sent += len(glb_of(shown, np.eye(4)))
        self.meshes.append(time.monotonic())

    def picked(self, pick: Pick | None) -> None:
        """Other views at a point."""

    def stated(self, state: State) -> None:
        """Anything else."""


def live(
    network: Network,
    capture: Capture,
    frames: list[int],
    settings: ReconstructionSettings,
) -> dict[str, float]:
    """Play frames of a capture as the viewer does.

    Returns:
        "frames", "width", "height"; "frames a second" up to the last; "first after", seconds from
        the start to the first piece of the mesh; "worst gap" between two refreshes from then to the
        last frame, and "mean gap", seconds; "whole after", seconds from the last frame to a mesh
        that is up to date; resident bytes when that
        frame was added ("memory at the last frame"), when the mesh was whole ("memory when whole")
        and after it was coloured otherwise `ROUNDS` times ("memory later"); "bytes sent" until it
        was whole.
    """
    watcher = Watcher()
    session = Session(network, capture, frames, settings, watcher)
    session.speed = 1000.0  # as fast as it goes
    start = time.monotonic()
    session.play(True)
    while session.position < len(frames):
        session.work()
    last, at_last = time.monotonic(), resident_memory()
    refreshed = [*(told for told in watcher.meshes if told <= last), last]
    gaps = np.diff(refreshed) if len(refreshed) > 1 else np.zeros(1)
    finish(session)
    whole, when_whole, sent = time.monotonic(), resident_memory(), watcher.sent
    for mode in ("best view", "image") * ROUNDS:
        session.paint(mode)
        finish(session)
    return {
        "frames": len(frames),
        "width": capture.size[0],
        "height": capture.size[1],
        "frames a second": len(frames) / (last - start),
        "first after": refreshed[0] - start,
        "worst gap": float(gaps.max()),
        "mean gap": float(gaps.mean()),
        "whole after": whole - last,
        "memory at the last frame": at_last,
        "memory when whole": when_whole,
        "memory later": resident_memory(),
        "bytes sent": sent,
    }


def finish(session: Session) -> None:
    """Work until nothing is left to do."""
    while session.work():
        pass
