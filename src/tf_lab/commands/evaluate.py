"""Evaluate meshes in the published layout."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from tf_lab.config.schema import EvaluateConfig
from tf_lab.errors import TFLabError
from tf_lab.evaluation.protocol import evaluate, scene_names
from tf_lab.evaluation.scores import format_table
from tf_lab.experiments.launcher import of_this_job
from tf_lab.support.files import check_file, write_json
from tf_lab.support.layout import GROUNDTRUTH_MESH
from tf_lab.support.progress import tracked
from tf_lab.support.words import counted


def run(config: EvaluateConfig) -> None:
    """Print the paper's metrics of every scene and their mean; write them if asked to."""
    predictions, groundtruth = Path(config.predictions), Path(config.groundtruth)
    output = of_this_job(Path(config.output)) if config.output is not None else None
    if output is not None:
        check_file(output)
    _check_groundtruth(groundtruth)
    bar = partial(tracked, description="evaluating")
    metrics = [*config.metrics.values()]
    result = evaluate(predictions, groundtruth, config.seed, bar, metrics)
    print(format_table([*result["scenes"].items(), ("mean", result["mean"])], first="Scene"))
    if output is not None:
        write_json(output, result)
    if result["missing"]:
        print("no prediction, scored as empty: " + ", ".join(result["missing"]))
        if unknown := result["unknown"]:  # of which one may be meant
            print(f"of no scene: {counted(len(unknown), 'other file')}, such as {unknown[0]}")
    if result["empty"]:
        print("no surface in it, scored as empty: " + ", ".join(result["empty"]))
    if result["point_clouds"]:
        print("no surface, scored by the points as they are: " + ", ".join(result["point_clouds"]))
    for name, remark in result["wrong_scale"].items():
        print(f"warning: {name} is {remark}")
    if result["failed"]:
        reasons = "; ".join(result["failed"].values())
        raise TFLabError(f"{len(result['failed'])} scene(s) left out of the mean: {reasons}")


def _check_groundtruth(folder: Path) -> None:
    """That a folder holds ground truth, before anything takes long.

    Raises:
        TFLabError: no scene in it has any.
    """
    names = scene_names(folder)
    if not any((folder / name / GROUNDTRUTH_MESH).exists() for name in names):
        raise TFLabError(
            f"{folder}: no ground truth in {counted(len(names), 'folder')} of it, such as "
            f"{names[0]}; give the folder of <scene>/mesh_gt.ply, <scene>/occlusion_mask.npy and "
            "<scene>/world2grid.txt"
        )
