from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from helpers.online.scenes import FAR, FRAMES, balanced, settings_of
from tf_lab.data.scene import Scene
from tf_lab.online.kept import Pick
from tf_lab.online.surface import Chunk
from tf_lab.viewer.session import Session, State


class Recorder:
    """A listener that keeps what it is told."""

    def __init__(self) -> None:
        self.frames: list[int] = []
        self.pieces: dict[Chunk, trimesh.Trimesh] = {}
        self.colors: dict[Chunk, np.ndarray] = {}
        self.told: list[Chunk] = []
        self.pick: Pick | None = None
        self.state: State | None = None

    def cleared(self) -> None:
        self.__init__()  # type: ignore[misc]

    def framed(self, source: int) -> None:
        self.frames.append(source)

    def meshed(self, chunk: Chunk, piece: trimesh.Trimesh | None, colors: np.ndarray) -> None:
        self.told.append(chunk)
        self.pieces.pop(chunk, None)
        if piece is not None:
            self.pieces[chunk], self.colors[chunk] = piece, colors

    def picked(self, pick: Pick | None) -> None:
        self.pick = pick

    def stated(self, state: State) -> None:
        self.state = state


@pytest.fixture(scope="session")
def scene(box_scene: Path) -> Scene:
    return Scene(box_scene)


@pytest.fixture(scope="session")
def network(tiny_network: Callable[..., Any], scene: Scene) -> Any:
    return balanced(tiny_network(far=FAR), scene)


@pytest.fixture(scope="session")
def make_session(network: Any, scene: Scene) -> Callable[[], Session]:
    """Of six frames, of one colour (others take most of the time); it works when it is told to."""

    def make() -> Session:
        settings = settings_of(resolution=0.1)
        session = Session(network, scene, list(FRAMES), settings, Recorder())
        session.mode = "clay"
        return session

    return make


@pytest.fixture
def session(make_session: Callable[[], Session]) -> Session:
    return make_session()


@pytest.fixture(scope="session")
def full(make_session: Callable[[], Session]) -> Session:
    """With all frames, for those who only look."""
    session = make_session()
    session.jump(len(FRAMES))
    while session.work():
        pass
    return session
