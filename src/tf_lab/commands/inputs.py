"""Inputs of the commands that reconstruct: captures, and the ground truth that they bring."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

from tf_lab.config.schema import CaptureConfig, FiguresConfig, ViewConfig
from tf_lab.data.capture import Capture
from tf_lab.data.diagnosis import quick_warning
from tf_lab.data.groundtruth import GroundTruthSettings, write_groundtruth
from tf_lab.data.readers import open_capture
from tf_lab.data.reading import ReadSettings
from tf_lab.data.resize import Resized
from tf_lab.data.scene import Scene
from tf_lab.data.settings import MOST_SIDE
from tf_lab.data.sources.source import DataSource, open_source
from tf_lab.errors import TFLabError
from tf_lab.online.settings import InferenceSettings
from tf_lab.reporting.results import Run, read_run
from tf_lab.support.layout import CONFIG, GROUNDTRUTH_MESH, TRAININGS
from tf_lab.support.records import record

C = TypeVar("C", ViewConfig, FiguresConfig)


def open_input(config: CaptureConfig, info: dict[str, Any]) -> Capture:
    """The input at the image size that the checkpoint was trained at; a test room without one."""
    if config.input is None:
        return first_test_scene(open_source(config.data))
    settings = ReadSettings.part_of(config)
    capture = open_capture(Path(config.input), settings)
    warning = quick_warning(capture, settings) if config.check else None
    if warning is not None:
        print(f"warning: {config.input}: {warning}", file=sys.stderr)
    size = trained_size(info)
    return Resized(capture, size) if size else capture


def first_test_scene(source: DataSource) -> Scene:
    """The one that is shown where none is named. Raises TFLabError: there is none."""
    scenes = source.scenes("test")["test"] if source.has("test") else {}
    if not scenes:
        raise TFLabError(f"data={source.settings.name}: no test scene (data.test, data.test_size)")
    return Scene(next(iter(scenes.values())))


def of_run(config: C, directory: Path) -> tuple[C, dict[str, Scene]]:
    """A run's network and settings as a config, and its test scenes, or the one asked for.

    Raises:
        TFLabError: they are not on this machine.
    """
    if not (directory / CONFIG).exists():
        state = "no run, there is no config.yaml in it" if directory.is_dir() else "no such folder"
        raise TFLabError(f"run={directory}: {state}; `python -m tf_lab.runs` lists the runs")
    run: Run = read_run(directory)
    chosen = [*run.scenes] if config.scene is None else [config.scene]
    if config.scene not in (None, *run.scenes):
        raise TFLabError(f"scene={config.scene}: {directory} has {', '.join(run.scenes)}")
    checkpoint = config.checkpoint or _own_checkpoint(directory, run)
    several = checkpoint if isinstance(checkpoint, list) else [checkpoint]
    source, digests = open_source(run.config.tested), run.makers[0].get("scenes", {})
    places = {name: source.directory(name, digests.get(name)) for name in chosen}
    there = {name: path for name, path in places.items() if path.exists()}
    for each in several:
        if each is None or not Path(each).exists():
            raise TFLabError(f"{directory}: its checkpoint ({each}) is not on this machine")
    if not there:
        path = places[chosen[0]]
        raise TFLabError(f"{directory}: its test scene ({path}) is not on this machine")
    names = ("select", *(field.name for field in fields(InferenceSettings)))
    settings = {name: getattr(run.config, name) for name in names}
    online = replace(config.online, precision=run.config.online.precision)  # the rest is this one's
    config = replace(config, checkpoint=checkpoint, online=online, **settings)
    return config, {name: Scene(path) for name, path in there.items()}


def _own_checkpoint(directory: Path, run: Run) -> str | None:
    """Of a run: where it was, or, seen from elsewhere or moved since, beside the run."""
    known = run.makers[0].get("checkpoint")
    if known is None or Path(known).exists():
        return known
    beside = directory.resolve().parents[1] / TRAININGS / Path(*Path(known).parts[-2:])
    return str(beside) if beside.exists() else known


def trained_size(info: dict[str, Any]) -> tuple[int, int] | None:
    """The (width, height) of the images that a checkpoint was trained at, if it says so.

    Raises:
        TFLabError: it says something else.
    """
    try:
        data = info["training"]["config"]["data"]
        size = record(tuple[int, int], [data["width"], data["height"]], "image size")
    except (KeyError, TypeError):
        return None
    except ValueError as error:
        raise TFLabError(f"the checkpoint's {error}; train it again") from error
    if not all(1 <= side <= MOST_SIDE for side in size):
        raise TFLabError(f"the checkpoint's image size {size} is impossible; train it again")
    return size


@contextmanager
def own_groundtruth(capture: Capture) -> Iterator[Path | None]:
    """A folder with a capture's ground truth, for as long as it is used.

    It is what the scene brings, or fused from the source's own depth; None without either.
    """
    with tempfile.TemporaryDirectory() as temporary:
        directory = Path(temporary)
        if isinstance(capture, Scene) and (capture.groundtruth / GROUNDTRUTH_MESH).exists():
            directory = capture.groundtruth
        else:
            _fuse_depth(capture, directory)
        yield directory if (directory / GROUNDTRUTH_MESH).exists() else None


def _fuse_depth(capture: Capture, directory: Path) -> None:
    """Ground truth from the source's own depth, if it has any; the mesh is there without it."""
    frames, unreadable = [], []
    for i in range(len(capture.frames)):
        try:
            if capture.depth(i) is not None:
                frames.append(i)
        except TFLabError as error:
            unreadable.append(error)
    if unreadable:
        print(f"{len(unreadable)} depth maps are left out; the first: {unreadable[0]}")
    if not frames:
        return
    try:
        write_groundtruth(capture, directory, GroundTruthSettings(), frames=frames, training=False)
    except TFLabError as error:
        print(f"not scored, because the depth cannot be fused: {error}")
