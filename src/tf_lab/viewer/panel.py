"""The controls beside the scene."""

from __future__ import annotations

from collections.abc import Callable
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
    """The page of one session: controls that ask it, and a listener that draws.

    Args:
        server: of viser.
        drawing: what is drawn; the session's frames in it.
    """

    session: Session

    def __init__(self, server: viser.ViserServer, drawing: Drawing) -> None:
        self.server, self.drawing = server, drawing

    def attach(self, session: Session) -> None:
        """Make the controls of a session."""
        self.session = session
        gui = self.server.gui
        self.status = gui.add_markdown("")
        with gui.add_folder("Frames"):
            self._frames()
        with gui.add_folder("Views kept"):
            self._selection()
        with gui.add_folder("Show"):
            self._display()
        self.kept = gui.add_html(kept_views(None))

        @self.server.scene.on_click()
        def _(event: Any) -> None:
            origin = np.array(event.ray_origin) - self.drawing.shift
            session.pick(origin, np.array(event.ray_direction))

    def _frames(self) -> None:
        gui, session = self.server.gui, self.session
        total = len(session.frames)
        self.playing = gui.add_button("Play")
        step = gui.add_button("Step", hint="add one frame")
        self.position: Any = gui.add_slider("Frame", 0, total, 1, 0, hint="jump; back starts again")
        speed = gui.add_slider("Frames a second", *SPEEDS, 1, round(session.speed))
        self.playing.on_click(lambda _: session.play(not session.playing))
        step.on_click(lambda _: session.step())
        self._on_change(self.position, session.jump)
        self._on_change(speed, lambda value: setattr(session, "speed", float(value)))

    def _selection(self) -> None:
        gui, settings = self.server.gui, self.session.settings
        views = gui.add_slider("K", 1, max(16, settings.views), 1, settings.views)
        names = [part.name for part in POLICIES]
        policy = gui.add_dropdown("Selection", names, initial_value=settings.select.policy)
        sizes = {f"{100 * FINE / n:.3g} cm": FINE / n for n in CELLS}
        nearest = min(sizes, key=lambda size: abs(sizes[size] - settings.resolution))
        resolution = gui.add_dropdown("Resolution", [*sizes], initial_value=nearest)
        change = self.session.change
        self._on_change(views, lambda value: change(views=value))
        self._on_change(policy, lambda value: change(select=value))
        self._on_change(resolution, lambda value: change(resolution=sizes[value]))

    def _display(self) -> None:
        gui, session, drawing = self.server.gui, self.session, self.drawing
        color = gui.add_dropdown("Colour", MODES, initial_value=session.mode)
        self.legend = gui.add_html("")
        near = gui.add_dropdown("Near surface", [*NEAR], initial_value="no")
        self.voxel = FINE

        def paint(mode: str) -> None:
            session.paint(mode)
            self.legend.content = legend_of(mode, len(session.capture.frames))

        def show_near(which: str) -> None:
            self.voxel = COARSE if NEAR[which] == "coarse" else FINE
            session.show_near(NEAR[which])

        self._on_change(color, paint)
        self._on_change(near, show_near)
        for what, label in (("mesh", "Mesh"), ("cameras", "Cameras"), ("path", "Trajectory")):
            self._on_change(gui.add_checkbox(label, True), partial(drawing.set_visible, what))
        self._on_change(gui.add_checkbox("Ground truth", False), self._show_truth)

    def _show_truth(self, visible: bool) -> None:
        truth = self.session.truth()
        if truth is None:
            self._say("There is no ground truth.")
            return
        if self.server.scene.get_handle_by_name(f"{self.drawing.name}/truth") is None:
            self.drawing.draw_truth(truth.mesh)
        self.drawing.set_visible("truth", visible)

    def _on_change(self, control: Any, act: Callable[[Any], Any]) -> None:
        """Act when somebody changes a control; not when the session itself does."""

        @control.on_update
        def _(event: Any) -> None:
            if event.client is not None:
                try:
                    act(control.value)
                except TFLabError as error:
                    self._say(str(error))

    def _say(self, text: str) -> None:
        for client in self.server.get_clients().values():
            client.add_notification("tf_lab", text, auto_close_seconds=10)

    # the session's listener

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
        self.playing.label = "Pause" if state.playing else "Play"
        self.position.value = state.position
        self.drawing.draw_near(state.near, self.voxel)
        self.status.content = (
            f"**{self.session.capture.name}**: {state.position} of {state.total} frames, "
            f"{state.vertices} vertices; {state.busy or 'up to date'}"
        )
        if state.trouble:
            self._say(state.trouble)
