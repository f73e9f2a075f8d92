"""Posed images from anywhere: one small module a layout, one function to open them all.

A reader is a module with ``NAME``, ``LAYOUT`` (what it looks for, for the error message),
``detect(directory)`` and ``read(directory)``, which gives the capture in the source's own world
frame. To add one, write the module and name it in `READERS`; turning z-up happens here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from tf_lab.data.capture import Capture
from tf_lab.data.gravity import align, find_down
from tf_lab.data.readers import plain, seven_scenes
from tf_lab.data.readers.folder import FolderCapture
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError


class Reader(Protocol):
    """What a reader module offers."""

    NAME: str
    LAYOUT: str

    def detect(self, directory: Path) -> bool:
        """Whether the directory looks like this layout."""
        ...

    def read(self, directory: Path) -> FolderCapture:
        """The capture in the source's world frame. Raises TFLabError."""
        ...


READERS: tuple[Reader, ...] = (seven_scenes, plain)
SCENE = "scene"


def open_capture(
    directory: Path | str, format: str | None = None, gravity: Sequence[float] | None = None
) -> Capture:
    """Open a directory of posed images as a capture in a z-up world.

    Args:
        directory: a prepared scene or a source in one of the layouts of `READERS`.
        format: the layout's name; None recognises it.
        gravity: the direction of gravity (down) in the source's world, for a source that does not
            state it (see `tf_lab.data.gravity`); without it, it is estimated.

    Raises:
        TFLabError: the directory is missing, of no known layout, or damaged.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise TFLabError(f"{directory}: no such folder; give the folder of a capture or scene")
    readers = {reader.NAME: reader for reader in READERS}
    name = _detect(directory) if format is None else format
    if name == SCENE:
        if gravity is not None:
            raise TFLabError(f"{directory}: a prepared scene is z-up already; leave out gravity")
        return Scene(directory)
    if name not in readers:
        known = ", ".join([SCENE, *readers])
        raise TFLabError(f"format={name}: no such layout; known are {known}")
    return _upright(readers[name].read(directory), directory, gravity)


def _detect(directory: Path) -> str:
    found = [SCENE] if (directory / "scene.json").is_file() else []
    found += [reader.NAME for reader in READERS if reader.detect(directory)]
    if len(found) > 1:
        raise TFLabError(f"{directory}: may be {' or '.join(found)}; say which with format=")
    if not found:
        layouts = [f"{SCENE} (scene.json)", *(f"{r.NAME} ({r.LAYOUT})" for r in READERS)]
        state = "of no known layout" if any(directory.iterdir()) else "empty"
        raise TFLabError(f"{directory}: {state}; looked for {'; '.join(layouts)}")
    return found[0]


def _upright(
    capture: FolderCapture, directory: Path, gravity: Sequence[float] | None
) -> FolderCapture:
    down = find_down(directory, capture.world_T_cam, gravity)
    world_T_cam, source_R_world = align(capture.world_T_cam, down)
    return replace(capture, world_T_cam=world_T_cam, source_R_world=source_R_world)
