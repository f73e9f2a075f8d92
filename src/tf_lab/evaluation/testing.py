"""Testing a network: reconstruct the scenes of a split, score them, draw them, save the row."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.evaluation.metrics import mean_metrics
from tf_lab.evaluation.pictures import compare
from tf_lab.evaluation.protocol import PROTOCOL, evaluate_scene
from tf_lab.meshes.files import read_mesh
from tf_lab.network.network import Network
from tf_lab.online.captures import Reconstruction, median_views, reconstruct
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.support.files import atomic_path, write_json
from tf_lab.support.progress import progress_bar

log = logging.getLogger(__name__)


def test_network(
    network: Network,
    scenes: Sequence[Path],
    settings: ReconstructionSettings,
    run: Path,
    label: str,
) -> dict[str, Any]:
    """Evaluate a network on scenes; write ``metrics.json``, meshes and pictures to the run.

    Args:
        network: in evaluation mode.
        scenes: scene directories with ground truth.
        settings: test-time settings.
        run: the run's directory; ``metrics.json`` is written last and means "finished".
        label: the row's name.

    Returns:
        What ``metrics.json`` holds.
    """
    results: dict[str, dict[str, float]] = {}
    details: dict[str, dict[str, Any]] = {}
    with progress_bar() as bar:
        task = bar.add_task("testing", total=len(scenes))
        for directory in scenes:
            scene = Scene(directory)
            start = time.time()
            result = reconstruct(network, scene, settings)
            seconds = time.time() - start
            scores = evaluate_scene(result.mesh, scene.groundtruth)
            results[scene.name] = scores
            details[scene.name] = {
                "seconds": round(seconds, 2),
                "keyframes": len(result.keyframes),
                "skipped": result.skipped,
                "median_views": median_views(scene, result.keyframes, scene.groundtruth),
            }
            save_mesh(result, run / "meshes" / f"{scene.name}.ply")
            draw(result, scene, run / "pictures" / f"{scene.name}.png", scores["fscore"])
            bar.update(task, advance=1, description=f"testing: F {scores['fscore']:.3f}")
    seen = float(np.mean([d["median_views"] for d in details.values()]))
    print(f"the median surface point of a test scene is seen by {seen:.0f} keyframes")
    metrics = {
        "protocol": PROTOCOL,
        "label": label,
        "mean": mean_metrics(results.values()),
        "scenes": results,
        "details": details,
    }
    write_json(run / "metrics.json", metrics)
    return metrics


test_network.__test__ = False  # type: ignore[attr-defined]  # not a test, whatever its name


def read_metrics(run: Path) -> dict[str, Any] | None:
    """The metrics of a finished run; None if it is not finished.

    Raises:
        TFLabError: the file is damaged.
    """
    path = run / "metrics.json"
    if not path.exists():
        return None
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise TFLabError(f"{path}: damaged ({error}); delete it to evaluate again") from error


def save_mesh(result: Reconstruction, path: Path) -> None:
    """Write a reconstruction's mesh as PLY, whole or not at all; it may be empty."""
    with atomic_path(path) as temporary:
        result.mesh.export(temporary, file_type="ply")


def draw(result: Reconstruction, scene: Scene, path: Path, fscore: float) -> None:
    """Input frames, prediction beside ground truth, and the error, as one PNG."""
    chosen = [result.keyframes[int(i)] for i in np.linspace(0, len(result.keyframes) - 1, 6)]
    truth = read_mesh(scene.groundtruth / "mesh_gt.ply")
    compare(result.mesh, truth, [scene.image(i) for i in chosen], path, scene.name, fscore)
