"""A page with a session."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tf_lab.data.capture import Capture
from tf_lab.evaluation.truth import Truth
from tf_lab.network.network import Network
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.viewer.panel import Panel
from tf_lab.viewer.scene import Drawing, look_from_above
from tf_lab.viewer.serve import LocalServer
from tf_lab.viewer.session import Session

ROOM = 1.5  # metres around the cameras that a page shows at first


def show_session(
    server: LocalServer,
    network: Network,
    capture: Capture,
    frames: list[int],
    settings: ReconstructionSettings,
    truth: Callable[[], Truth | None],
) -> Session:
    """Make the page of a session; the session has not started. Arguments as of `Session`."""
    panel = Panel(server, Drawing(server))
    session = Session(network, capture, frames, settings, panel, truth)
    panel.attach(session)
    centers = np.asarray(capture.world_T_cam)[:, :3, 3]
    look_from_above(server, np.stack([centers.min(0) - ROOM, centers.max(0) + ROOM]))
    return session
