"""Posed images to a mesh, with the shipped checkpoint or one of yours."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from tf_lab.benchmarks.plane_sweep import plane_sweep
from tf_lab.commands.inputs import open_input, own_groundtruth
from tf_lab.config.build import capture_settings, ready
from tf_lab.config.schema import ReconstructConfig
from tf_lab.data.camera_noise import Disturbed
from tf_lab.data.capture import Capture
from tf_lab.errors import TFLabError
from tf_lab.evaluation.pictures import compare
from tf_lab.evaluation.protocol import evaluate_scene
from tf_lab.evaluation.scores import Scores, format_table
from tf_lab.experiments.launcher import of_this_job
from tf_lab.meshes.decimate import check_share, decimated
from tf_lab.meshes.files import read_mesh, write_mesh
from tf_lab.meshes.glb import glb_of
from tf_lab.network.checkpoint import load_network, shipped_checkpoint
from tf_lab.network.network import Network
from tf_lab.online.reconstruction import Reconstruction, reconstruct
from tf_lab.poses.refined import Refined
from tf_lab.support.devices import device_of
from tf_lab.support.files import atomic_path, check_file, file_name, told_apart
from tf_lab.support.layout import GROUNDTRUTH_MESH
from tf_lab.support.progress import progress_bar
from tf_lab.support.words import counted

NETWORK, STEREO = METHODS = ("network", "plane_sweep")
WRITERS: dict[str, Callable[[trimesh.Trimesh, Path], Any]] = {
    ".ply": write_mesh,
    ".glb": lambda mesh, path: path.write_bytes(glb_of(mesh)),
}


def run(config: ReconstructConfig) -> None:
    """Reconstruct, write mesh and picture, score where the depth is known."""
    checkpoint = Path(config.checkpoint) if config.checkpoint else shipped_checkpoint()
    network, info = load_network(checkpoint)
    if config.method not in METHODS:
        raise TFLabError(f"method={config.method}: choose {' or '.join(METHODS)}")
    network = ready(network, config.online, device_of(config.device))
    capture_settings(config)  # what is wrong with them is told before the capture is read
    output = _place(config)
    if output.suffix not in WRITERS:
        raise TFLabError(f"output={output}: the mesh is written as {' or '.join(WRITERS)}")
    check_file(output)
    check_share(config.decimate)
    capture = open_input(config, info)
    if config.input is None and config.output is None:
        output = output.with_stem(file_name(capture.name))
    output = of_this_job(output)
    start = time.time()
    posed = _posed(capture, config)
    result = _reconstruct(network, posed, config)
    seconds = time.time() - start
    mesh = result.mesh
    if config.source_frame:
        mesh = _in_source_frame(mesh, capture)
    mesh = decimated(mesh, config.decimate)
    with atomic_path(output) as temporary:
        WRITERS[output.suffix](mesh, temporary)
    _tell(capture, result, seconds, config)
    if not len(mesh.faces):
        print(f"{output}: no surface was found; the mesh is empty")
        return
    print(f"{output}: {len(mesh.vertices)} vertices, {len(mesh.faces)} faces")
    _score_and_draw(capture, result, output.with_suffix(".png"), config.score)


def _place(config: ReconstructConfig) -> Path:
    """Where the mesh goes: by default a place of this input's own, by its path from here.

    Of an input outside of this folder the name is enough, with a hash of its path.
    """
    if config.output is not None:
        return Path(config.output)
    source, here = Path(os.path.abspath(config.input or "room")), Path.cwd()  # noqa: PTH100
    inside = here in source.parents
    path = source.relative_to(here) if inside else Path(told_apart(source.name, str(source)))
    return Path("outputs/reconstructions", path.parent, f"{path.name}.ply")


def _posed(capture: Capture, config: ReconstructConfig) -> Capture:
    """The capture with the cameras that it is reconstructed with."""
    posed: Capture = Disturbed(capture, config.camera_noise)
    if not config.refine_poses:
        return posed
    with progress_bar() as bar:
        task = bar.add_task("following points", total=None)

        def show(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        refined = Refined(posed, capture_settings(config).keyframe_distance, progress=show)
    change = refined.change
    fit = f"{change.after:.2f} pixels instead of {change.before:.2f}"
    if not change.sightings:
        print("poses as given: no points could be followed through three keyframes")
    elif change.kept:
        print(f"poses as given: others would explain the images little better ({fit})")
    else:
        print(
            f"poses refined: points are seen where they are to {fit}; keyframes turned by "
            f"{change.turn:.2f} degrees and moved by {1000 * change.move:.1f} mm in the median"
        )
    return refined


def _reconstruct(network: Network, capture: Capture, config: ReconstructConfig) -> Reconstruction:
    settings = capture_settings(config)
    with progress_bar() as bar:
        task = bar.add_task("adding keyframes", total=None)

        def show(done: int, total: int) -> None:
            text = "fusing and meshing" if done == total else "adding keyframes"
            bar.update(task, completed=done, total=total, description=text)

        if config.method == STEREO:
            return plane_sweep(capture, settings.keyframe_distance, progress=show)
        return reconstruct(network, capture, settings, show)


def _tell(
    capture: Capture, result: Reconstruction, seconds: float, config: ReconstructConfig
) -> None:
    """Print what became of the frames; what could not be read was told when it was met."""
    keyframes, frames = counted(len(result.keyframes), "keyframe"), len(capture.frames)
    skipped = counted(len(capture.skipped) + len(result.skipped), "frame")
    print(
        f"{capture.name}: {keyframes} of {counted(frames, 'frame')} "
        f"({'x'.join(map(str, capture.size))}) in {seconds:.1f} s, {skipped} skipped"
    )
    for reason in capture.skipped[:10]:
        print(f"  skipped {reason}")
    if len(result.keyframes) == 1:
        print(
            "warning: of one keyframe no distance can be seen; give more frames, or more of them "
            f"by a smaller keyframe_distance= (now {config.keyframe_distance:g})",
            file=sys.stderr,
        )
    elif config.method == NETWORK and config.views > len(result.keyframes):
        print(f"views={config.views} of only {keyframes}: each point keeps all that see it")


def _score_and_draw(capture: Capture, result: Reconstruction, picture: Path, score: bool) -> None:
    """Draw the mesh; where the source has depth, beside the mesh fused from it, with the score."""
    spread = np.linspace(0, len(result.keyframes) - 1, 6).astype(int)
    images = [capture.image(result.keyframes[i]) for i in np.unique(spread)]
    truth: trimesh.Trimesh | None = None
    scores: Scores | None = None
    with progress_bar() as bar:
        depth = "fusing its own depth to score it (score=false: not)"
        task = bar.add_task(depth if score else "drawing", total=1)
        with own_groundtruth(capture) if score else nullcontext() as groundtruth:
            bar.update(task, description="scoring")
            if groundtruth is not None:
                scores = evaluate_scene(result.mesh, groundtruth)
                truth = read_mesh(groundtruth / GROUNDTRUTH_MESH)
        bar.update(task, description="drawing")
        fscore = scores["fscore"] if scores else None
        compare(result.mesh, truth, images, picture, capture.name, fscore)
        bar.update(task, completed=1)
    if scores:
        print("against the mesh fused from its own depth:")
        print(format_table([(capture.name, scores)], first="Scene"))
    print(f"{picture}: a picture of it")


def _in_source_frame(mesh: trimesh.Trimesh, capture: Capture) -> trimesh.Trimesh:
    """A copy in the world of the source's poses."""
    return mesh.copy().apply_transform(capture.source_T_world)
