"""A page with sessions."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from tf_lab.data.capture import Capture
from tf_lab.evaluation.truth import Truth
from tf_lab.network.network import Network
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.viewer.panel import Panel, SessionPart
from tf_lab.viewer.scene import Drawing, look_from_above
from tf_lab.viewer.serve import LocalServer
from tf_lab.viewer.session import Session

Side = tuple[Network, ReconstructionSettings]  # to begin with
ROOM = 1.5  # metres around the cameras that a page shows at first


def show_sessions(
    server: LocalServer,
    sides: Mapping[str, Side],
    capture: Capture,
    frames: list[int],
    truth: Callable[[], Truth | None],
) -> list[Session]:
    """Make the page of sessions, side by side under one camera; none has started.

    Args:
        server: of the page.
        sides: what reconstructs, by the name that is shown.
        capture: and the rest as of `Session`.
        frames: of it.
        truth: gives the ground truth.
    """
    centers = np.asarray(capture.world_T_cam)[:, :3, 3]
    low, high = centers.min(0) - ROOM, centers.max(0) + ROOM
    step = np.array([high[0] - low[0], 0, 0])
    parts = []
    for number, (name, (network, settings)) in enumerate(sides.items()):
        part = SessionPart(Drawing(server, f"/scene{number}", number * step), name)
        part.session = Session(network, capture, frames, settings, part, truth)
        parts.append(part)
        if len(sides) > 1:
            place = np.array([*centers.mean(0)[:2], high[2]])
            server.scene.add_label(f"/scene{number}/name", name, position=place)
    panel = Panel(server, parts)
    look_from_above(server, np.stack([low, high + (len(parts) - 1) * step]))
    return panel.sessions
