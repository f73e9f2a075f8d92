"""A reconstruction that plays: its frames, its clock, the picked point. It knows no page.

All work is done bit by bit by `Session.work`, in one thread; what others ask for is only noted, so
that nobody who asks waits. What comes of it is told to a `Listener`.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import trimesh

from tf_lab.data.capture import Capture
from tf_lab.errors import TFLabError
from tf_lab.evaluation.truth import Truth
from tf_lab.network.network import Network
from tf_lab.online.kept import Pick, pick
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.online.surface import Chunk
from tf_lab.viewer.growth import Growth, Pieces
from tf_lab.viewer.paint import MODES, painter

log = logging.getLogger(__name__)

REFRESH = 0.15  # seconds after which the mesh comes before the next frame
AGAIN = 0.015  # the same after a chunk that came out as before: time for one frame


class Listener(Protocol):
    """What is told about a session, in the thread that works."""

    def cleared(self) -> None:
        """All starts from nothing."""

    def framed(self, source: int) -> None:
        """A frame of the capture was added."""

    def meshed(self, chunk: Chunk, piece: trimesh.Trimesh | None, colors: np.ndarray) -> None:
        """A chunk's surface or its colours (uint8 [V, 3]) changed; None: it has none any more."""

    def picked(self, pick: Pick | None) -> None:
        """Another point, or other views at it."""

    def stated(self, state: State) -> None:
        """Anything else changed."""


@dataclass(frozen=True)
class State:
    """Where a session stands.

    Attributes:
        position: frames that were added or skipped.
        total: frames there are.
        playing: whether the next frame comes by itself.
        busy: what is being done, in a word; "" when all is up to date.
        vertices: of the mesh.
        near: centres [N, 3] (metres) of near-surface voxels, if asked for.
        trouble: what could not be done.
    """

    position: int
    total: int
    playing: bool
    busy: str
    vertices: int
    near: np.ndarray
    trouble: str = ""


class Session:
    """A capture being reconstructed, controlled from other threads.

    Args:
        network: on its device, in evaluation mode.
        capture: of the network's image size.
        frames: of the capture, in the order in which they are added.
        settings: to begin with.
        listener: is told what changes.
        truth: gives the ground truth, None without any; asked when it is first needed.
    """

    def __init__(
        self,
        network: Network,
        capture: Capture,
        frames: list[int],
        settings: ReconstructionSettings,
        listener: Listener,
        truth: Callable[[], Truth | None] = lambda: None,
    ) -> None:
        self.network, self.capture, self.frames = network, capture, frames
        self.settings, self.listener, self.truth = settings, listener, truth
        self.growth = Growth(network, settings)
        self.position = self.target = 0
        self.playing, self.speed = False, 10.0
        self.mode, self.near = MODES[0], ""
        self.point: np.ndarray | None = None
        self._ray: tuple[np.ndarray, np.ndarray] | None = None
        self._pick_again = self._restart = self._repaint = self._state_due = False
        self._unpainted: set[Chunk] = set()
        self._stopped, self._trouble = False, ""
        self._due = self._meshed = 0.0
        self._patience = REFRESH
        self._wake = threading.Condition()

    # what others ask for

    def play(self, playing: bool) -> None:
        """Go on by itself, or stop to."""
        self._note(playing=playing, _due=time.monotonic())

    def go_at(self, speed: float) -> None:
        """Add so many frames a second while it plays."""
        self._note(speed=speed)

    def jump(self, position: int) -> None:
        """Have so many frames added: fewer than now starts again."""
        with self._wake:
            self.target = min(max(position, 0), len(self.frames))
            self._restart |= self.target < self.position
            self._wake.notify()

    def step(self, frames: int = 1) -> None:
        """Add so many frames."""
        self.jump(self.target + frames)

    def change(self, **settings: Any) -> None:
        """Reconstruct what has been added again with other settings.

        Raises:
            TFLabError: a value that cannot be; nothing changes then.
        """
        self._note(settings=replace(self.settings, **settings), _restart=True)

    def paint(self, mode: str) -> None:
        """Colour the mesh by one of `MODES`."""
        self._note(mode=mode, _repaint=True)

    def show_near(self, level: str) -> None:
        """Tell the near-surface voxels of a level, "coarse" or "fine"; "": none."""
        self._note(near=level, _state_due=True)

    def pick(self, origin: np.ndarray, direction: np.ndarray) -> None:
        """Pick the point of the mesh that a ray meets first."""
        self._note(_ray=(np.asarray(origin, float), np.asarray(direction, float)))

    def _note(self, **changes: Any) -> None:
        with self._wake:
            for name, value in changes.items():
                setattr(self, name, value)
            self._state_due = True
            self._wake.notify()

    # the work

    def start(self) -> threading.Thread:
        """Work in a thread of its own until `stop`."""
        thread = threading.Thread(target=self._run, daemon=True, name="session")
        thread.start()
        return thread

    def stop(self) -> None:
        """End the thread after what it is doing."""
        self._note(_stopped=True)

    def _run(self) -> None:
        while not self._stopped:
            try:
                worked = self.work()
            except TFLabError as error:
                self._trouble, worked = str(error), True
            except Exception as error:  # too little memory, say; the page lives on
                log.exception("the viewer's work broke off")
                self._trouble, worked = f"{type(error).__name__}: {error}", False
                self.playing = False  # until somebody asks for something
                self.listener.stated(self._state(""))
            if not worked:
                with self._wake:
                    self._wake.wait(self._pause())

    def work(self) -> bool:
        """Do the most urgent bit; False if there is none.

        Frames come when they are due, but the mesh is never older than `REFRESH` where that can
        be helped; chunks that come out as before do not count.
        """
        with self._wake:
            job, busy = self._next()
            self._state_due = False
        if job is not None:
            job()
        self.listener.stated(self._state(busy))
        return job is not None

    def _next(self) -> tuple[Callable[[], None] | None, str]:
        growth = self.growth
        if self._repaint:  # the mesh as it is now: only this thread changes it
            self._repaint, self._unpainted = False, set(growth.pieces)
        old = time.monotonic() - self._meshed > self._patience
        if self._restart:
            return self._begin, "starting again"
        if self._ray is not None:
            return self._find, "looking"
        if self._unpainted:  # somebody asked for it; where frames always wait, its turn never came
            return self._paint_one, "colouring"
        if self._frame_is_due() and not (growth.stale and old):
            return self._add, "adding frames"
        if growth.stale:
            hurry = self._pause() is not None
            return lambda: self._tell(growth.mesh_next(roughly=hurry)), "meshing"
        if not growth.settled:
            return self._settle, "meshing"
        if self._pick_again and self.point is not None:
            return self._look, "looking"
        return (lambda: None) if self._state_due else None, ""

    def _frame_is_due(self) -> bool:
        if self.position < self.target:
            return True
        return self.playing and self.position < len(self.frames) and self._pause() == 0

    def _pause(self) -> float | None:
        """Seconds until the next frame; None: it does not come by itself."""
        if not self.playing or self.position >= len(self.frames):
            return None
        return max(self._due - time.monotonic(), 0.0)

    def _begin(self) -> None:
        self._restart = False
        self.growth = Growth(self.network, self.settings)
        self.position = 0
        self._unpainted = set()
        self.listener.cleared()

    def _add(self) -> None:
        frame = self.frames[self.position]
        self.position += 1
        self.target = max(self.target, self.position)
        self._due = max(self._due + 1 / self.speed, time.monotonic() - REFRESH)
        self._pick_again = True
        self.growth.add(self.capture, frame)
        self.listener.framed(frame)

    def _settle(self) -> None:
        self._tell(self.growth.settle())
        self._pick_again = True

    def _tell(self, pieces: Pieces) -> None:
        for chunk in pieces:
            self._paint(chunk)
        self._meshed = time.monotonic()
        self._patience = REFRESH if pieces else AGAIN
        if self.point is not None and pieces:
            self._look()

    def _paint_one(self) -> None:
        self._paint(self._unpainted.pop())

    def _paint(self, chunk: Chunk) -> None:
        piece = self.growth.pieces.get(chunk)
        self._unpainted.discard(chunk)
        colors = np.empty((0, 3), np.uint8)
        if piece is not None:
            total = len(self.capture.frames)
            try:
                colors = painter(self.mode, self.growth, total, self.truth)(piece)
            except TFLabError:
                self.mode, self._repaint = MODES[0], True
                raise
        self.listener.meshed(chunk, piece, colors)

    def _find(self) -> None:
        assert self._ray is not None
        ray, self._ray = self._ray, None  # another may come meanwhile
        point = self.growth.hit(*ray)
        if point is not None:
            self.point = point
            self._look()

    def _look(self) -> None:
        assert self.point is not None
        self._pick_again = False
        self.listener.picked(pick(self.growth.reconstructor, self.growth.sources, self.point))

    def _state(self, busy: str) -> State:
        trouble, self._trouble = self._trouble, ""
        return State(
            self.position,
            len(self.frames),
            self.playing and self.position < len(self.frames),
            busy,
            sum(len(piece.vertices) for piece in self.growth.pieces.values()),
            self.growth.near(self.near) if self.near else np.empty((0, 3)),
            trouble,
        )
