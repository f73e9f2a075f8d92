"""Posed images from anywhere: one small module a layout, one function to open them all.

A reader is a module with ``NAME``, ``LAYOUT`` (what it looks for, for the error message),
``detect(path)`` and ``read(path)``, which gives the capture in the source's own world frame. To add
one, write the module and name it in `READERS`; turning z-up and metric happens here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from tf_lab.data.capture import Capture
from tf_lab.data.gravity import align, find_down
from tf_lab.data.origin import check_extent
from tf_lab.data.readers import (
    arkit,
    colmap,
    images,
    plain,
    polycam,
    record3d,
    replica,
    scanner_app,
    scannet,
    sensreader,
    seven_scenes,
    stray_scanner,
    transforms,
    tum,
    video,
)
from tf_lab.data.readers.mend import mended
from tf_lab.data.readers.parsing import HOW_TO_POSES
from tf_lab.data.readers.source import SourceCapture
from tf_lab.data.reading import AS_STATED, ReadSettings
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.support.words import counted


class Reader(Protocol):
    """What a reader module offers."""

    NAME: str
    LAYOUT: str

    def detect(self, path: Path) -> bool:
        """Whether a directory (or file) looks like this layout; quick, and never raises."""
        ...

    def read(self, path: Path) -> SourceCapture:
        """The capture in the source's world frame. Raises TFLabError."""
        ...


READERS: tuple[Reader, ...] = (
    seven_scenes,
    plain,
    scannet,
    tum,
    transforms,
    colmap,
    arkit,
    stray_scanner,
    scanner_app,
    polycam,
    record3d,
    sensreader,
    replica,
    video,
)
SCENE = "scene"


def open_capture(
    path: Path | str, settings: ReadSettings = AS_STATED, strict: bool = True
) -> Capture:
    """Open posed images as a capture in a z-up world in metres.

    Args:
        path: a prepared scene or a source in one of the layouts of `READERS`.
        settings: how it is read.
        strict: False takes what cannot be right, for a check: principal points outside of the
            images, cameras too far apart, poses of unknown scale.

    Raises:
        TFLabError: the source is missing, of no known layout, or damaged, or the settings do not
            fit it.
    """
    path = Path(path)
    if not path.exists():
        raise TFLabError(f"{path}: no such folder or file; give the folder of a capture or scene")
    readers = {reader.NAME: reader for reader in READERS}
    name = _detect(path) if settings.format is None else settings.format
    if name == SCENE:
        if settings != ReadSettings(settings.format):
            raise TFLabError(
                f"{path}: a prepared scene is z-up already, in metres, and has been mended; leave "
                "out gravity, scale and the mends, or prepare it again"
            )
        return Scene(path)
    if name not in readers:
        known = ", ".join([SCENE, *readers])
        raise TFLabError(f"format={name}: no such layout; known are {known}")
    return as_read(readers[name].read(path), path, settings, strict)


def as_read(
    source: SourceCapture, path: Path, settings: ReadSettings, strict: bool = True
) -> SourceCapture:
    """What a reader found at a path, mended, z-up and in metres; see `open_capture`."""
    capture = mended(source, settings, centred=strict)
    return _upright(_metric(capture, path, settings.scale, strict), path, settings.gravity)


def detect_format(path: Path) -> list[str]:
    """The layouts that a folder or file may be of: none, one, or several to choose from."""
    found = [SCENE] if (path / "scene.json").is_file() else []
    return found + [reader.NAME for reader in READERS if reader.detect(path)]


def _detect(path: Path) -> str:
    found = detect_format(path)
    if len(found) > 1:
        raise TFLabError(f"{path}: may be {' or '.join(found)}; say which with format=")
    if not found:
        raise TFLabError(f"{path}: {_why_unknown(path)}")
    return found[0]


def _why_unknown(path: Path) -> str:
    """What is wrong with a path of no known layout, and what to do."""
    inner = capture_within(path)
    if inner is not None:
        return f"holds captures, and is none itself; give one of them, such as {inner}"
    if found := _pictures(path):
        if (path / "poses.txt").is_file():
            return (
                f"{found} and poses.txt, but not as {plain.LAYOUT}; put the images in images/, or "
                "keep one video"
            )
        return (
            f"{found}, but no camera poses; {HOW_TO_POSES}; of a known layout, format=NAME says "
            "which of its files is missing"
        )
    if path.is_dir() and not any(path.iterdir()):
        return f"empty; posed images go in it, at the simplest as {plain.LAYOUT}"
    layouts = [f"{SCENE} (scene.json)", *(f"{r.NAME} ({r.LAYOUT})" for r in READERS)]
    return f"of no known layout; looked for {'; '.join(layouts)}"


def _pictures(path: Path) -> str:
    """The images or the video in a folder, or in one in it; empty: there are none."""
    if path.is_file():
        return "an image" if path.suffix.lower() in images.IMAGE_SUFFIXES else ""
    for folder in (path, *_folders(path)):
        where = f" in {folder.name}/" if folder != path else ""
        if count := len(images.image_files(folder)):
            return f"{counted(count, 'image')}{where}"
        if video.video_files(folder):
            return f"a video{where}"
    return ""


def capture_within(path: Path) -> Path | None:
    """The first folder of a known layout in a folder or in the folders in it."""
    folders = _folders(path)
    inner = (deeper for folder in folders for deeper in _folders(folder))
    return next((folder for folder in (*folders, *inner) if detect_format(folder)), None)


def _folders(path: Path) -> list[Path]:
    return sorted(p for p in path.iterdir() if p.is_dir()) if path.is_dir() else []


def _metric(capture: SourceCapture, path: Path, scale: float | None, strict: bool) -> SourceCapture:
    """The capture in metres."""
    if scale is None:
        if not strict:
            return capture
        if capture.metric:
            check_extent(path, capture.world_T_cam)
            return capture
        raise TFLabError(
            f"{path}: its unit of length is unknown (structure from motion gives none); give "
            "scale=METRES_PER_UNIT: a distance you know in metres over the same in the model"
        )
    world_T_cam, unit = capture.world_T_cam.copy(), np.eye(4)
    world_T_cam[:, :3, 3] *= scale
    unit[:3, :3] /= scale
    source_T_world = capture.source_T_world @ unit
    return replace(capture, world_T_cam=world_T_cam, source_T_world=source_T_world)


def _upright(capture: SourceCapture, path: Path, gravity: Sequence[float] | None) -> SourceCapture:
    """The capture in a world whose z axis points up."""
    directory = path if path.is_dir() else path.parent
    mirror = capture.source_T_world[:3, :3] / np.cbrt(np.abs(np.linalg.det(capture.source_T_world)))
    seen = capture.world_T_cam.copy()
    seen[:, :3] = mirror @ seen[:, :3]  # in the source's world
    down = mirror.T @ find_down(directory, seen, gravity, capture.down)
    world_T_cam, turned = align(capture.world_T_cam, down)
    return replace(capture, world_T_cam=world_T_cam, source_T_world=capture.source_T_world @ turned)
