"""What an evaluation keeps of a scene: mesh, picture, scores and how they came about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tf_lab.data.groundtruth import DepthMaps, GroundTruth
from tf_lab.data.scene import Scene
from tf_lab.evaluation.pictures import compare
from tf_lab.evaluation.protocol import PROTOCOL
from tf_lab.evaluation.scores import Scores
from tf_lab.meshes.files import read_mesh, write_mesh
from tf_lab.online.captures import Reconstruction, median_views
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.views.statistics import ViewSets, view_sets
from tf_lab.support.files import atomic_path, file_name, write_json


@dataclass(frozen=True)
class SceneResult:
    """The scores of a test scene, and details: seconds, keyframes, frames skipped, views, and what
    the views are worth that voxels keep (`ViewSets`).
    """

    scores: Scores
    details: dict[str, Any]


def save_scene(
    result: Reconstruction, scene: Scene, scores: Scores, seconds: float, run: Path
) -> SceneResult:
    """Write a scene's mesh and picture to a run.

    Args:
        result: the reconstruction.
        scene: with ground truth.
        scores: of the reconstruction.
        seconds: that it took.
        run: the run's directory.
    """
    name = file_name(scene.name)
    with atomic_path(run / "meshes" / f"{name}.ply") as temporary:
        write_mesh(result.mesh, temporary)
    draw(result, scene, run / "pictures" / f"{name}.png", scores["fscore"])
    details = {
        "seconds": round(seconds, 2),
        "keyframes": len(result.keyframes),
        "skipped": result.skipped,
        "median_views": median_views(scene, result.keyframes, scene.groundtruth),
    }
    if result.online is not None:
        details["view_sets"] = asdict(surface_views(result.online, scene, result.keyframes))
    return SceneResult(scores, details)


def surface_views(online: Reconstructor, scene: Scene, keyframes: Sequence[int]) -> ViewSets:
    """What the views are worth that fine voxels at the true surface keep."""
    level = online.fine
    rows = torch.arange(level.blocks.rows, device=level.device)
    if len(rows):
        distance = GroundTruth(scene.groundtruth).surface_distance(level.points(rows).cpu())
        rows = rows[(distance < level.voxel / 2).to(level.device)]
    return view_sets(level, rows, DepthMaps(scene, keyframes))


def draw(result: Reconstruction, scene: Scene, path: Path, fscore: float) -> None:
    """Input frames, prediction beside ground truth, and the error, as one PNG."""
    chosen = [result.keyframes[int(i)] for i in np.linspace(0, len(result.keyframes) - 1, 6)]
    truth = read_mesh(scene.groundtruth / "mesh_gt.ply")
    compare(result.mesh, truth, [scene.image(i) for i in chosen], path, scene.name, fscore)


def write_metrics(
    run: Path, label: str, mean: Mapping[str, float], results: Mapping[str, SceneResult]
) -> None:
    """Write a run's ``metrics.json``, which means that the run is finished.

    Args:
        run: its directory.
        label: the row's name.
        mean: of each metric over scenes.
        results: by scene.
    """
    metrics = {
        "protocol": PROTOCOL,
        "label": label,
        "mean": dict(mean),
        "scenes": {name: result.scores for name, result in results.items()},
        "details": {name: result.details for name, result in results.items()},
    }
    write_json(run / "metrics.json", metrics)
