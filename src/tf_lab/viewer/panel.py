"""The controls beside the scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from tf_lab.errors import TFLabError
from tf_lab.geometry import COARSE, FINE
from tf_lab.online.kept import Pick
from tf_lab.online.surface import Chunk
from tf_lab.online.views import POLICIES
from tf_lab.viewer.html import kept_views, legend_of
from tf_lab.viewer.paint import MODES
from tf_lab.viewer.scene import Drawing
from tf_lab.viewer.session import Session, State

if TYPE_CHECKING:
    import viser

CELLS = (1, 2, 3, 4, 5, 10)  # marching-cubes cells along a fine voxel's edge
NEAR = {"no": "", "coarse (30 cm)": "coarse", "fine (10 cm)": "fine"}
SPEEDS = (1, 30)  # frames a second


class Panel:
    """The controls of a page, which ask all its sessions alike: of one capture, side by side.

    Args:
        server: of viser.
        parts: a session and what draws it, each; at least one.
    """

    def __init__(self, server: viser.ViserServer, parts: Sequence[SessionPart]) -> None:
        self.server, self.parts = server, parts
        self.sessions = [part.session for part in parts]
        gui = server.gui
        for part in parts:
            part.status = gui.add_markdown("")
        with gui.add_folder("Frames"):
            self._frames()
        with gui.add_folder("Views kept"):
            self._selection()
        with gui.add_folder("Show"):
            self._display()
        for part in parts:
            part.kept = gui.add_html(kept_views(None))
        server.scene.on_click()(self._pick)

    def _pick(self, event: Any) -> None:
        """The point that the ray meets, of whichever mesh."""
        for part in self.parts:
            origin = np.array(event.ray_origin) - part.drawing.shift
            part.session.pick(origin, np.array(event.ray_direction))

    def _ask(self, what: str, *given: Any, **settings: Any) -> None:
        """The same of all sessions."""
        for session in self.sessions:
            getattr(session, what)(*given, **settings)

    def _frames(self) -> None:
        gui, session = self.server.gui, self.sessions[0]
        total = len(session.frames)
        playing = gui.add_button("Play")
        step = gui.add_button("Step", hint="add one frame")
        position: Any = gui.add_slider("Frame", 0, total, 1, 0, hint="jump; back starts again")
        speed = gui.add_slider("Frames a second", *SPEEDS, 1, round(session.speed))
        playing.on_click(lambda _: self._ask("play", not session.playing))
        step.on_click(lambda _: self._ask("step"))
        self._on_change(position, lambda value: self._ask("jump", value))
        self._on_change(speed, lambda value: self._ask("go_at", float(value)))
        self.parts[0].playing, self.parts[0].position = playing, position

    def _selection(self) -> None:
        gui, settings = self.server.gui, self.sessions[0].settings
        views = gui.add_slider("K", 1, max(16, settings.views), 1, settings.views)
        names = [part.name for part in POLICIES]
        policy = gui.add_dropdown("Selection", names, initial_value=settings.select.policy)
        sizes = {f"{100 * FINE / n:.3g} cm": FINE / n for n in CELLS}
        nearest = min(sizes, key=lambda size: abs(sizes[size] - settings.resolution))
        resolution = gui.add_dropdown("Resolution", [*sizes], initial_value=nearest)
        ask = partial(self._ask, "change")
        self._on_change(views, lambda value: ask(views=value))
        self._on_change(policy, lambda value: ask(select=value))
        self._on_change(resolution, lambda value: ask(resolution=sizes[value]))

    def _display(self) -> None:
        gui, session = self.server.gui, self.sessions[0]
        color = gui.add_dropdown("Colour", MODES, initial_value=session.mode)
        legend = gui.add_html("")
        near = gui.add_dropdown("Near surface", [*NEAR], initial_value="no")

        def paint(mode: str) -> None:
            self._ask("paint", mode)
            legend.content = legend_of(mode, len(session.capture.frames))

        def show_near(which: str) -> None:
            for part in self.parts:
                part.voxel = COARSE if NEAR[which] == "coarse" else FINE
            self._ask("show_near", NEAR[which])

        self._on_change(color, paint)
        self._on_change(near, show_near)
        for what, label in (("mesh", "Mesh"), ("cameras", "Cameras"), ("path", "Trajectory")):
            self._on_change(gui.add_checkbox(label, True), partial(self._set_visible, what))
        self._on_change(gui.add_checkbox("Ground truth", False), self._show_truth)

    def _set_visible(self, what: str, visible: bool) -> None:
        for part in self.parts:
            part.drawing.set_visible(what, visible)

    def _show_truth(self, visible: bool) -> None:
        truth = self.sessions[0].truth()
        if truth is None:
            say(self.server, "There is no ground truth.")
            return
        for part in self.parts:
            if self.server.scene.get_handle_by_name(f"{part.drawing.name}/truth") is None:
                part.drawing.draw_truth(truth.mesh)
        self._set_visible("truth", visible)

    def _on_change(self, control: Any, act: Callable[[Any], Any]) -> None:
        """Act when somebody changes a control; not when the session itself does."""

        @control.on_update
        def _(event: Any) -> None:
            if event.client is not None:
                try:
                    act(control.value)
                except TFLabError as error:
                    say(self.server, str(error))


def say(server: viser.ViserServer, text: str) -> None:
    """Tell whoever looks."""
    for client in server.get_clients().values():
        client.add_notification("tf_lab", text, auto_close_seconds=10)


class SessionPart:
    """A session's part of the page: what is drawn and written as it tells.

    Args:
        drawing: the session's, in the scene.
        name: that it is called by.

    Attributes:
        session: which tells; given when there is one.
        status, kept: where it is written.
        playing, position: controls that follow the session, if they do this one.
        voxel: edge of the near-surface voxels that are shown, metres.
    """

    session: Session
    status: Any
    kept: Any

    def __init__(self, drawing: Drawing, name: str) -> None:
        self.drawing, self.name, self.voxel = drawing, name, FINE
        self.playing: Any = None
        self.position: Any = None

    def cleared(self) -> None:
        """All starts from nothing."""
        self.drawing.clear()

    def framed(self, source: int) -> None:
        """A frame was added."""
        images = self.session.growth.reconstructor.frames.images
        image = images[-1].permute(1, 2, 0).numpy()
        self.drawing.draw_camera(self.session.capture, source, image)

    def meshed(self, chunk: Chunk, piece: trimesh.Trimesh | None, colors: np.ndarray) -> None:
        """A chunk changed."""
        self.drawing.draw_piece(chunk, piece, colors)

    def picked(self, pick: Pick | None) -> None:
        """Other views at the picked point."""
        self.kept.content = kept_views(pick)
        if pick is not None:
            self.drawing.draw_pick(pick, self.session.capture)

    def stated(self, state: State) -> None:
        """Anything else changed."""
        if self.position is not None:
            self.playing.label = "Pause" if state.playing else "Play"
            self.position.value = state.position
        self.drawing.draw_near(state.near, self.voxel)
        self.status.content = (
            f"**{self.name}**: {state.position} of {state.total} frames, "
            f"{state.vertices} vertices; {state.busy or 'up to date'}"
        )
        if state.trouble:
            say(self.drawing.server, state.trouble)
