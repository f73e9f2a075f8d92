"""The paper's figures by one command, of whatever there is."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from tf_lab.benchmarks.plane_sweep import plane_sweep
from tf_lab.commands.inputs import of_run, open_input, own_groundtruth
from tf_lab.config.build import capture_settings, ready
from tf_lab.config.schema import FiguresConfig
from tf_lab.data.capture import Capture
from tf_lab.data.keyframes import Thinned
from tf_lab.data.scene import Scene
from tf_lab.data.sources.source import open_source
from tf_lab.errors import TFLabError
from tf_lab.evaluation.protocol import evaluate_scene
from tf_lab.meshes.files import read_mesh
from tf_lab.network.checkpoint import load_network, shipped_checkpoint
from tf_lab.online.reconstruction import Reconstruction, reconstruct
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.reporting.figures.catalog import draw_figures
from tf_lab.reporting.figures.contract import Compared, Material, Shown
from tf_lab.reporting.gallery import compared, groundtruth_mesh, scenes_of
from tf_lab.reporting.paper import OURS
from tf_lab.reporting.results import read_run
from tf_lab.reporting.studies import Study, open_study
from tf_lab.support.devices import device_of
from tf_lab.support.documents import read_json
from tf_lab.support.files import check_folder
from tf_lab.support.layout import GROUNDTRUTH_MESH

STEREO = "Plane-sweep stereo"
SHOWN_ROWS = 4  # of a study, in the comparison
FEW_VIEWS = 4  # K, beside the K asked for
SHOWN_POLICIES = ("attention", "random")


def run(config: FiguresConfig) -> None:
    """Draw what there is something for; say in a line each what there is not."""
    output = Path(config.output)
    check_folder(output)
    with Workbench(config) as bench:
        material = bench.material()
        if config.input is not None or config.run is not None:
            bench.open()  # where it is wrong, other figures are no answer
        files, left_out = draw_figures(config.figures, material, output)
    if not files:
        raise TFLabError("; ".join(left_out))
    print(*left_out, f"{output}: {', '.join(path.name for path in files)}", sep="\n")


def material_of(study: Study, benchmark: str) -> Material:
    """What the figures of a report are drawn of."""

    def shown() -> Shown:
        found = [run for (row, _), run in study.runs.items() if row == OURS]
        run = next(iter(found or study.runs.values()))
        parts = {name: getattr(run.config, name) for name in ("data", "select", "online")}
        with Workbench(FiguresConfig(run=str(run.directory), **parts)) as bench:
            return bench.shown()

    return Material(
        cache(shown),
        cache(partial(compared_rows, study, len(study.scenes))),
        partial(all_rows, study),
        lambda: study,
        partial(_measured, benchmark),
    )


def compared_rows(study: Study, count: int, scene: str | None = None) -> list[Compared]:
    """Some test scenes under some rows of a study, ours last.

    Raises:
        TFLabError: no run has a mesh, or there is no such scene.
    """
    scenes = _with_meshes(study, scene)
    found = []
    for name, runs in [*scenes.items()][:count]:
        rows = dict(reversed([*runs.items()][:SHOWN_ROWS]))
        found.append(compared(rows, name, groundtruth_mesh(next(iter(rows.values())), name)))
    return found


def all_rows(study: Study, scene: str | None = None) -> Compared:
    """A test scene under all rows of a study. Errors as of `compared_rows`."""
    name, runs = next(iter(_with_meshes(study, scene).items()))
    return compared(runs, name, groundtruth_mesh(next(iter(runs.values())), name))


def _with_meshes(study: Study, scene: str | None) -> Mapping[str, Any]:
    shown = scenes_of(study)
    if not shown:
        raise TFLabError(f"no run of study {study.key} has its meshes on this machine")
    return _only(shown, scene)


def _only(scenes: Mapping[str, Any], scene: str | None) -> Mapping[str, Any]:
    """All scenes, or the one asked for. Raises TFLabError: it is not there."""
    if scene is None:
        return scenes
    if scene not in scenes:
        raise TFLabError(f"scene={scene}: there is {', '.join(scenes)}")
    return {scene: scenes[scene]}


def _measured(path: str) -> Mapping[str, Any]:
    cure = "run python -m tf_lab.benchmark, or give benchmark=FILE"
    if not Path(path).exists():
        raise TFLabError(f"{path}: no such file; {cure}")
    found = read_json(Path(path), cure)
    if not isinstance(found, dict) or "frame" not in found:
        raise TFLabError(f"{path}: has no times of frames; {cure}")
    return found


class Workbench:
    """Reconstructs what figures ask for, each but once."""

    def __init__(self, config: FiguresConfig) -> None:
        self.asked = config
        self._stack = ExitStack()
        self._made: dict[tuple[str, str, int | None], Reconstruction] = {}
        self._truths: dict[str, Path | None] = {}

    def __enter__(self) -> Workbench:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def open(self) -> None:
        """Open the input. Raises TFLabError: it cannot be."""
        _ = self._input

    def material(self) -> Material:
        """All of it: of the study's meshes, unless an input, run or checkpoint is given."""
        config = self.asked
        own = any(x is not None for x in (config.input, config.run, config.checkpoint))
        return Material(
            cache(self.shown),
            cache(lambda: self.compared() if own or not self._has_meshes() else self._rows()),
            lambda: self.ablations() if own or not self._has_meshes() else self._all_rows(),
            lambda: self.study,
            partial(_measured, config.benchmark),
            _points(config.points),
        )

    def shown(self) -> Shown:
        """The first scene by the network."""
        name, capture = next(iter(self.scenes.items()))
        directory = self._truth(name)
        truth = None if directory is None else read_mesh(directory / GROUNDTRUTH_MESH)
        return Shown(capture, self._make(name, self.settings), truth)

    def compared(self) -> list[Compared]:
        """Some scenes by stereo and by the network, of the same frames."""
        count, found = self.asked.frames, []
        for name in [*self.scenes][: self.config.scenes]:
            made = {
                STEREO: self._make(name, STEREO, count),
                self.label: self._make(name, self.settings, count),
            }
            few = None if count is None else len(made[self.label].keyframes)
            found.append(replace(self._compared(name, made), frames=few))
        return found

    def ablations(self) -> Compared:
        """The first scene by the network, with few and many views, of every policy."""
        name, settings = next(iter(self.scenes)), self.settings
        found = {}
        for views in sorted({FEW_VIEWS, settings.views}):
            for policy in SHOWN_POLICIES:
                select = settings.select if policy == settings.select.policy else policy
                made = self._make(name, replace(settings, views=views, select=select))
                found[f"K = {views}, {policy}"] = made
        return self._compared(name, found)

    def _compared(self, name: str, made: Mapping[str, Reconstruction]) -> Compared:
        meshes, directory = {key: each.mesh for key, each in made.items()}, self._truth(name)
        if directory is None:
            return Compared(name, meshes, None)
        scores = {key: evaluate_scene(mesh, directory)["fscore"] for key, mesh in meshes.items()}
        return Compared(name, meshes, read_mesh(directory / GROUNDTRUTH_MESH), scores)

    def _make(
        self, name: str, how: ReconstructionSettings | str, frames: int | None = None
    ) -> Reconstruction:
        """A scene's mesh by stereo or a network; of so many keyframes, or of all."""
        key = (name, str(how), frames)
        if key not in self._made:
            capture, distance = self.scenes[name], self.settings.keyframe_distance
            if frames is not None:
                capture = Thinned(capture, frames, distance)
            if isinstance(how, str):
                self._made[key] = plane_sweep(capture, distance)
            else:
                self._made[key] = reconstruct(self.network, capture, how)
        return self._made[key]

    def _truth(self, name: str) -> Path | None:
        if name not in self._truths:
            context = own_groundtruth(self.scenes[name])
            self._truths[name] = self._stack.enter_context(context)
        return self._truths[name]

    @cached_property
    def _input(self) -> tuple[FiguresConfig, Mapping[str, Capture]]:
        config = self.asked
        if config.run is not None:
            return of_run(config, Path(config.run))
        if config.input is not None:
            capture = open_input(config, self._loaded[1])
            return config, _only({capture.name: capture}, config.scene)
        rooms = open_source(config.data).scenes("test")["test"]
        return config, {name: Scene(path) for name, path in _only(rooms, config.scene).items()}

    @cached_property
    def _loaded(self) -> tuple[Any, dict[str, Any]]:
        path = self.asked.checkpoint if self.asked.run is None else self.config.checkpoint
        return load_network(Path(path) if path else shipped_checkpoint())

    @property
    def config(self) -> FiguresConfig:
        """With a run's settings, if there is a run."""
        return self._input[0]

    @property
    def scenes(self) -> Mapping[str, Capture]:
        """By name; at least one."""
        return self._input[1]

    @cached_property
    def network(self) -> Any:
        """On its device."""
        return ready(self._loaded[0], self.config.online, device_of(self.config.device))

    @cached_property
    def settings(self) -> ReconstructionSettings:
        """How it reconstructs."""
        return capture_settings(self.config)

    @property
    def label(self) -> str:
        """What the network is called."""
        if self.asked.run is not None:
            return read_run(Path(self.asked.run)).row
        path = self.asked.checkpoint
        return str(Path(*Path(path).parts[-2:])) if path else "Shipped checkpoint"

    @cached_property
    def study(self) -> Study:
        """The runs'."""
        runs = self.asked.runs
        return open_study([runs] if isinstance(runs, str) else runs, self.asked.study)[0]

    def _has_meshes(self) -> bool:
        try:
            return bool(scenes_of(self.study))
        except TFLabError:  # there is no study
            return False

    def _rows(self) -> list[Compared]:
        return compared_rows(self.study, self.asked.scenes, self.asked.scene)

    def _all_rows(self) -> Compared:
        return all_rows(self.study, self.asked.scene)


def _points(given: Any) -> np.ndarray | None:
    if given is None:
        return None
    try:
        points = np.array(given, float)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise TFLabError(f"points={given}: give [[x,y,z],...], metres")
    return points
