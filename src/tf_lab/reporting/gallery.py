"""The same room under every row, side by side, from the meshes of the runs."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import trimesh
from PIL import Image

from tf_lab.errors import TFLabError
from tf_lab.meshes.files import read_mesh
from tf_lab.reporting.figures.contract import Compared
from tf_lab.reporting.figures.meshes import ablations
from tf_lab.reporting.paper import OURS
from tf_lab.reporting.results import Run
from tf_lab.reporting.studies import Study
from tf_lab.support.figures import write_figure
from tf_lab.support.files import file_name
from tf_lab.support.layout import GROUNDTRUTH_MESH, mesh_path
from tf_lab.support.progress import progress_bar

COLORS = 32  # meshes are of one colour: shades enough, and a small file


def scene_runs(study: Study, scene: str) -> dict[str, Run]:
    """The run to show of each row that has a mesh of a scene: ours first, then as in the tables.

    All are of one seed, that with the most such rows.
    """
    by_seed = {
        seed: {
            row: study.runs[row, seed]
            for row in [OURS, *study.rows]
            if (row, seed) in study.runs
            and mesh_path(study.runs[row, seed].directory, scene).exists()
        }
        for seed in study.seeds()
    }
    return max(by_seed.values(), key=len)  # of equals the lowest seed


def draw_pictures(study: Study, folder: Path, size: tuple[int, int] = (400, 300)) -> int:
    """Draw the test scenes of which there are meshes; of the others what is there stays."""
    shown = scenes_of(study)
    if not shown:
        return 0
    left_out = []
    with progress_bar() as bar:
        for scene, runs in bar.track(shown.items(), len(shown), description="drawing"):
            try:
                truth = groundtruth_mesh(next(iter(runs.values())), scene)
                draw_scene(runs, scene, truth, folder / f"{file_name(scene)}.png", size)
            except TFLabError as error:
                left_out.append(f"no picture of {scene}: {error}")
    for line in left_out:
        print(f"warning: {line}", file=sys.stderr)
    return len(shown) - len(left_out)


def groundtruth_mesh(run: Run, scene: str) -> trimesh.Trimesh | None:
    """The ground truth of a run's test scene, if it is on this machine."""
    if not run.config.tested.root:  # a kept copy
        return None
    from tf_lab.data.scene import Scene  # they import torch
    from tf_lab.data.sources.source import open_source
    from tf_lab.evaluation.scenes import scene_truth

    digest = run.makers[0].get("scenes", {}).get(scene)
    directory = open_source(run.config.tested).directory(scene, digest)
    if not (directory / "groundtruth" / GROUNDTRUTH_MESH).exists():
        return None
    given = run.config.groundtruth
    return scene_truth(Scene(directory), None if given is None else Path(given)).mesh


def draw_scene(
    runs: dict[str, Run],
    scene: str,
    groundtruth: trimesh.Trimesh | None,
    path: Path,
    size: tuple[int, int] = (400, 300),
) -> None:
    """Draw a scene's ground truth, if there is one, and its mesh in every run, as one PNG.

    Args:
        runs: by row, all of one seed, at least one.
        scene: its name.
        groundtruth: mesh in metres.
        path: the PNG.
        size: (width, height) of a panel, pixels.

    Raises:
        TFLabError: a mesh cannot be read, or there is nothing to draw.
    """
    seed = next(iter(runs.values())).seed
    drawn = ablations(compared(runs, scene, groundtruth), size, f"{scene}, seed {seed}")
    write_figure(drawn.figure, path, COLORS)


def compared(runs: dict[str, Run], scene: str, groundtruth: trimesh.Trimesh | None) -> Compared:
    """A scene's meshes in runs by row; arguments and errors as of `draw_scene`."""
    meshes = {row: read_mesh(mesh_path(run.directory, scene)) for row, run in runs.items()}
    scores = {row: run.scenes[scene] for row, run in runs.items()}
    fscores = {row: score["fscore"] for row, score in scores.items() if "fscore" in score}
    return Compared(scene, meshes, groundtruth, fscores)


def scenes_of(study: Study) -> dict[str, dict[str, Run]]:
    """The runs to show (`scene_runs`) of every test scene that has meshes on this machine."""
    return {scene: runs for scene in study.scenes if (runs := scene_runs(study, scene))}


def preview(path: Path, width: int = 1000) -> bytes:
    """A picture as a JPEG of at most so many pixels across, small enough to keep in a notebook."""
    with Image.open(path) as picture:
        small = picture.convert("RGB")
    small.thumbnail((width, width))
    content = io.BytesIO()
    small.save(content, "JPEG", quality=80)
    return content.getvalue()
