"""Look at a reconstruction in the browser."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import trimesh

from tf_lab.commands.inputs import of_run, open_input, own_groundtruth
from tf_lab.config.build import capture_settings, ready
from tf_lab.config.schema import ViewConfig
from tf_lab.data.capture import Capture
from tf_lab.data.keyframes import select_keyframes
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.evaluation.truth import Truth
from tf_lab.meshes.files import read_mesh
from tf_lab.meshes.glb import read_glb
from tf_lab.network.checkpoint import load_network, shipped_checkpoint
from tf_lab.support.devices import device_of
from tf_lab.support.layout import GROUNDTRUTH_MESH
from tf_lab.viewer.live import Side, show_sessions
from tf_lab.viewer.serve import LocalServer
from tf_lab.viewer.still import show_meshes


def run(config: ViewConfig) -> None:
    """Serve the page until somebody interrupts."""
    server = LocalServer(config.port)  # told before anything that takes long
    if config.mesh is not None:
        meshes = {path: _read(Path(path)) for path in _listed(config.mesh)}
        truth = None if config.groundtruth is None else _read(Path(config.groundtruth))
        show_meshes(server, meshes, truth)
        server.wait()
        return
    capture, sides = _sides_of_runs(config) if config.run is not None else _sides(config)
    _, settings = next(iter(sides.values()))
    frames = select_keyframes(capture.world_T_cam, settings.keyframe_distance)
    truth = _truth_of(capture, config.groundtruth)
    sessions = show_sessions(server, sides, capture, frames, truth)
    if config.play:
        first = threading.Event()

        @server.on_client_connect
        def _(_: Any) -> None:
            if not first.is_set():
                first.set()
                for session in sessions:
                    session.play(True)

    for session in sessions:
        session.start()
    server.wait()


def _sides_of_runs(config: ViewConfig) -> tuple[Capture, dict[str, Side]]:
    """A test scene of one or more runs, the first's unless asked for, and what each ran."""
    paths = [Path(path) for path in _listed(config.run)]
    if len(paths) > 1 and config.checkpoint is not None:
        raise TFLabError("checkpoint= goes with one run=, not with several side by side")
    capture: Scene | None = None
    sides: list[dict[str, Side]] = []
    for path in paths:
        own, scenes = of_run(config, path)
        name, scene = next(iter(scenes.items()))
        config = replace(config, scene=name)  # the others are asked for the same
        capture = capture or scene
        if scene.directory.resolve() != capture.directory.resolve():
            raise TFLabError(f"run={path}: its {name} is another than that of {paths[0]}")
        sides.append(_sides(own, capture)[1])
    assert capture is not None
    if len(paths) == 1:
        return capture, sides[0]
    first = [next(iter(found.values())) for found in sides]
    return capture, dict(zip(_names("run", paths), first, strict=True))


def _sides(config: ViewConfig, capture: Capture | None = None) -> tuple[Capture, dict[str, Side]]:
    """The input, if no capture is given, and the network of every checkpoint."""
    given = [config.checkpoint] if config.checkpoint is None else _listed(config.checkpoint)
    checkpoints = [Path(path) if path else shipped_checkpoint() for path in given]
    loaded = [load_network(path) for path in checkpoints]
    device = device_of(config.device)
    networks = [ready(network, config.online, device) for network, _ in loaded]
    capture = capture or open_input(config, loaded[0][1])
    names = [capture.name] if len(given) == 1 else _names("checkpoint", checkpoints)
    settings = capture_settings(config)
    return capture, {n: (network, settings) for n, network in zip(names, networks, strict=True)}


def _listed(given: str | list[str]) -> list[str]:
    return [given] if isinstance(given, str) else given


def _names(setting: str, paths: list[Path]) -> list[str]:
    """Short names that differ: of files, or with the folders that they lie in."""
    for parts in range(1, max(len(path.parts) for path in paths) + 1):
        names = [str(Path(*path.parts[-parts:])) for path in paths]
        if len(set(names)) == len(names):
            return names
    raise TFLabError(f"{setting}={paths[0]}: is given twice")


def _read(path: Path) -> trimesh.Trimesh:
    """A mesh of either kind that `tf_lab.reconstruct` writes."""
    return read_glb(path) if path.suffix == ".glb" else read_mesh(path)


def _truth_of(capture: Capture, path: str | None) -> Any:
    """What gives a capture's ground truth, made once, when it is first asked for."""
    lock = threading.Lock()

    @cache
    def make() -> Truth | None:
        if path is not None:
            return Truth(_read(Path(path)))
        with own_groundtruth(capture) as directory:
            return None if directory is None else Truth(read_mesh(directory / GROUNDTRUTH_MESH))

    def truth() -> Truth | None:
        with lock:
            return make()

    return truth
