"""Posed images to a mesh, with the shipped checkpoint or one of yours."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from tf_lab.benchmarks.plane_sweep import plane_sweep
from tf_lab.config.build import capture_settings, ready
from tf_lab.config.schema import ReconstructConfig
from tf_lab.data.capture import Capture
from tf_lab.data.diagnosis import quick_warning
from tf_lab.data.groundtruth import GroundTruthSettings, write_groundtruth
from tf_lab.data.readers import open_capture
from tf_lab.data.reading import ReadSettings
from tf_lab.data.resize import Resized
from tf_lab.data.scene import Scene
from tf_lab.data.settings import MOST_SIDE
from tf_lab.data.sources.source import open_source
from tf_lab.errors import TFLabError
from tf_lab.evaluation.pictures import compare
from tf_lab.evaluation.protocol import evaluate_scene
from tf_lab.evaluation.scores import format_table
from tf_lab.meshes.files import read_mesh, write_mesh
from tf_lab.network.checkpoint import load_network, shipped_checkpoint
from tf_lab.network.network import Network
from tf_lab.online.captures import Reconstruction, reconstruct
from tf_lab.support.devices import device_of
from tf_lab.support.files import atomic_path, check_file, file_name
from tf_lab.support.progress import progress_bar
from tf_lab.support.records import record

NETWORK, STEREO = METHODS = ("network", "plane_sweep")


def run(config: ReconstructConfig) -> None:
    """Reconstruct, write mesh and picture, score where the depth is known."""
    checkpoint = Path(config.checkpoint) if config.checkpoint else shipped_checkpoint()
    network, info = load_network(checkpoint)
    if config.method not in METHODS:
        raise TFLabError(f"method={config.method}: choose {' or '.join(METHODS)}")
    network = ready(network, config.online, device_of(config.device))
    output = _place(config)
    if output.suffix != ".ply":
        raise TFLabError(f"output={output}: the mesh is written as .ply")
    check_file(output)
    capture = _open(config, info)
    if config.input is None and config.output is None:
        output = output.with_stem(file_name(capture.name))
    start = time.time()
    result = _reconstruct(network, capture, config)
    seconds = time.time() - start
    mesh = result.mesh
    if config.source_frame:
        mesh = _in_source_frame(mesh, capture)
    with atomic_path(output) as temporary:
        write_mesh(mesh, temporary)
    skipped = [*capture.skipped, *result.skipped]
    print(
        f"{capture.name}: {len(result.keyframes)} keyframes of {len(capture.frames)} frames in "
        f"{seconds:.1f} s, {len(skipped)} frames skipped"
    )
    for reason in skipped[:10]:
        print(f"  skipped {reason}")
    if not len(mesh.faces):
        print(f"{output}: no surface was found; the mesh is empty")
        return
    print(f"{output}: {len(mesh.vertices)} vertices, {len(mesh.faces)} faces")
    _score_and_draw(capture, result, output.with_suffix(".png"))


def _place(config: ReconstructConfig) -> Path:
    """Where the mesh goes: by default a place of this input's own, because it holds its path."""
    if config.output is not None:
        return Path(config.output)
    source, here = Path(os.path.abspath(config.input or "room")), Path.cwd()  # noqa: PTH100
    path = source.relative_to(here if here in source.parents else source.anchor)
    return Path("outputs/reconstructions", path.parent, f"{path.name}.ply")


def _open(config: ReconstructConfig, info: dict[str, Any]) -> Capture:
    """The input at the image size that the checkpoint was trained at; a test room without one."""
    if config.input is None:
        rooms = open_source(config.data).scenes("test")["test"]
        return Scene(next(iter(rooms.values())))
    settings = ReadSettings.part_of(config)
    capture = open_capture(Path(config.input), settings)
    warning = quick_warning(capture, settings) if config.check else None
    if warning is not None:
        print(f"warning: {config.input}: {warning}", file=sys.stderr)
    size = _trained_size(info)
    return Resized(capture, size) if size else capture


def _trained_size(info: dict[str, Any]) -> tuple[int, int] | None:
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


def _reconstruct(network: Network, capture: Capture, config: ReconstructConfig) -> Reconstruction:
    settings = capture_settings(config)
    with progress_bar() as bar:
        task = bar.add_task("adding keyframes", total=None)

        def show(done: int, total: int) -> None:
            text = "fusing and meshing" if done == total else "adding keyframes"
            bar.update(task, completed=done, total=total, description=text)

        if config.method == STEREO:
            distance, device = settings.keyframe_distance, device_of(config.device)
            return plane_sweep(capture, distance, progress=show, device=device)
        return reconstruct(network, capture, settings, show)


def _score_and_draw(capture: Capture, result: Reconstruction, picture: Path) -> None:
    """Draw the mesh; where the source has depth, beside the mesh fused from it, with the score."""
    frames = [result.keyframes[int(i)] for i in np.linspace(0, len(result.keyframes) - 1, 6)]
    images = [capture.image(i) for i in frames]
    truth: trimesh.Trimesh | None = None
    fscore = None
    with tempfile.TemporaryDirectory() as temporary:
        groundtruth = Path(temporary)
        if isinstance(capture, Scene) and (capture.groundtruth / "mesh_gt.ply").exists():
            groundtruth = capture.groundtruth
        else:
            _fuse_depth(capture, groundtruth)
        if (groundtruth / "mesh_gt.ply").exists():
            scores = evaluate_scene(result.mesh, groundtruth)
            print("against the mesh fused from its own depth:")
            print(format_table([(capture.name, scores)], first="Scene"))
            truth, fscore = read_mesh(groundtruth / "mesh_gt.ply"), scores["fscore"]
    compare(result.mesh, truth, images, picture, capture.name, fscore)
    print(f"{picture}: a picture of it")


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
        write_groundtruth(capture, directory, GroundTruthSettings(), frames=frames)
    except TFLabError as error:
        print(f"not scored, because the depth cannot be fused: {error}")


def _in_source_frame(mesh: trimesh.Trimesh, capture: Capture) -> trimesh.Trimesh:
    """A copy in the world of the source's poses."""
    return mesh.copy().apply_transform(capture.source_T_world)
