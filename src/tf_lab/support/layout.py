"""What lies where in an output folder: trainings, evaluations ("runs"), and what is in each.

::

    trainings/NAME/  config.yaml  run.json  last.ckpt  model.safetensors  loss.png  logs/
    runs/NAME/       config.yaml  run.json  metrics.json  meshes/SCENE.ply  pictures/SCENE.png
"""

from __future__ import annotations

from pathlib import Path

from tf_lab.support.files import file_name

TRAININGS, RUNS = "trainings", "runs"
CONFIG = "config.yaml"
ORIGIN = "run.json"  # where it comes from: provenance
LAST = "last.ckpt"  # to train on
WEIGHTS = "model.safetensors"  # of a finished training
SCORES = "metrics.json"  # of a finished evaluation
PICTURES = "pictures"

# in a scene's folder of ground truth, as published
GROUNDTRUTH_MESH, OCCLUSION_MASK, WORLD2GRID = (
    "mesh_gt.ply",
    "occlusion_mask.npy",
    "world2grid.txt",
)


def mesh_path(run: Path, scene: str) -> Path:
    """Where a run keeps the mesh of a test scene."""
    return run / "meshes" / f"{file_name(scene)}.ply"


def picture_path(run: Path, scene: str) -> Path:
    """Where a run keeps the picture of a test scene."""
    return run / PICTURES / f"{file_name(scene)}.png"
