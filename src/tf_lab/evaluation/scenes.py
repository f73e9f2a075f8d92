"""What an evaluation keeps of a scene: mesh, picture, scores and how they came about."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh

from tf_lab.data.groundtruth import DepthMaps, GroundTruth
from tf_lab.data.scene import Scene
from tf_lab.data.visibility import scene_visibility
from tf_lab.errors import TFLabError
from tf_lab.evaluation.pictures import compare
from tf_lab.evaluation.protocol import PROTOCOL, PublishedGroundTruth, read_groundtruth
from tf_lab.evaluation.scores import Scores
from tf_lab.meshes.files import write_mesh
from tf_lab.online.reconstruction import Reconstruction
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.views.statistics import ViewSets, view_sets
from tf_lab.support.files import atomic_path, file_name, write_json
from tf_lab.support.layout import SCORES, mesh_path, picture_path
from tf_lab.support.records import read_record, record

KEPT = "scenes"  # of a run that is not finished: what there is of its scenes


@dataclass(frozen=True)
class SceneResult:
    """The scores of a test scene, and details: seconds, keyframes, frames skipped, views, and what
    the views are worth that voxels keep (`ViewSets`).
    """

    scores: Scores
    details: dict[str, Any]


def scene_truth(scene: Scene, given: Path | None = None) -> PublishedGroundTruth:
    """What a test scene is scored by, in its world.

    Args:
        scene: the scene.
        given: a folder in the published layout, in the worlds of the captures; None: the scene's
            own ground truth.

    Raises:
        TFLabError: a file is missing, damaged or of a wrong shape.
    """
    if given is None:
        return read_groundtruth(scene.groundtruth)
    return read_groundtruth(given / scene.name).moved(np.linalg.inv(scene.source_T_world))


def save_scene(
    result: Reconstruction,
    scene: Scene,
    truth: trimesh.Trimesh,
    scores: Scores,
    seconds: float,
    run: Path,
    code: str,
) -> SceneResult:
    """Write a scene's mesh and picture to a run, and, until that is finished, what it returns.

    Args:
        result: the reconstruction.
        scene: with ground truth.
        truth: the mesh that it is scored by.
        scores: of the reconstruction.
        seconds: that it took.
        run: the run's directory.
        code: which code this is.
    """
    with atomic_path(mesh_path(run, scene.name)) as temporary:
        write_mesh(result.mesh, temporary)
    draw(result, scene, truth, picture_path(run, scene.name), scores["fscore"])
    details = {
        "seconds": round(seconds, 2),
        "keyframes": len(result.keyframes),
        "skipped": result.skipped,
        "median_views": scene_visibility(scene, result.keyframes).median,
    }
    if result.online is not None:
        details["view_sets"] = asdict(surface_views(result.online, scene, result.keyframes))
    write_json(_kept(run, scene.name), {"code": code, "scores": scores, "details": details})
    return SceneResult(scores, details)


def kept_scene(run: Path, scene: str, code: str) -> SceneResult | None:
    """What `save_scene` kept of a scene of a run that is not finished, if the same code did."""
    try:
        kept = read_record(dict[str, Any], _kept(run, scene), "")
        result = record(SceneResult, {name: kept[name] for name in ("scores", "details")})
    except (TFLabError, ValueError, KeyError):
        return None
    return result if kept["code"] == code else None


def _kept(run: Path, scene: str) -> Path:
    return run / KEPT / f"{file_name(scene)}.json"


def surface_views(online: Reconstructor, scene: Scene, keyframes: Sequence[int]) -> ViewSets:
    """What the views are worth that fine voxels at the true surface keep."""
    level = online.fine
    rows = torch.arange(level.blocks.rows, device=level.device)
    if len(rows):
        distance = GroundTruth(scene.groundtruth).surface_distance(level.points(rows).cpu())
        rows = rows[(distance < level.voxel / 2).to(level.device)]
    return view_sets(level, rows, DepthMaps(scene, keyframes))


def draw(
    result: Reconstruction, scene: Scene, truth: trimesh.Trimesh, path: Path, fscore: float
) -> None:
    """Input frames, prediction beside ground truth, and the error, as one PNG."""
    chosen = [result.keyframes[int(i)] for i in np.linspace(0, len(result.keyframes) - 1, 6)]
    compare(result.mesh, truth, [scene.image(i) for i in chosen], path, scene.name, fscore)


def write_metrics(
    run: Path, label: str, mean: Mapping[str, float], results: Mapping[str, SceneResult]
) -> None:
    """Write a run's ``metrics.json``, which means that the run is finished.

    What was kept of its scenes till then goes.

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
    write_json(run / SCORES, metrics)
    shutil.rmtree(run / KEPT, ignore_errors=True)
