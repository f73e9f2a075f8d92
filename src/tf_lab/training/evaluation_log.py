"""An evaluation where its training is logged: scores, pictures and meshes."""

from __future__ import annotations

import os
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from tf_lab.config.schema import TrainConfig
from tf_lab.evaluation.scores import Metrics
from tf_lab.experiments.identity import training_directory
from tf_lab.meshes.decimate import at_most
from tf_lab.meshes.files import read_mesh
from tf_lab.meshes.glb import glb_of, vertex_colors
from tf_lab.support.files import atomic_directory, file_name
from tf_lab.support.layout import mesh_path, picture_path
from tf_lab.training.loggers import account, is_wandb

FACES = 60_000  # of a logged mesh, where faces can be left out
TENSORBOARD = "TensorBoardLogger"


def log_run(config: TrainConfig, run: Path, metrics: Metrics) -> None:
    """Log a finished evaluation with W&B or TensorBoard, if that is asked for.

    Args:
        config: of the training.
        run: the evaluation's directory.
        metrics: what it measured.
    """
    if is_wandb(config.logger):
        _to_wandb(config, run, metrics)
    elif str(config.logger._target_).endswith(f".{TENSORBOARD}"):
        _to_tensorboard(run, metrics)


def _to_wandb(config: TrainConfig, run: Path, metrics: Metrics) -> None:
    """As a W&B run of its own, because a training may have many evaluations.

    But under ``wandb agent`` all belongs to the one run that the agent has begun. A table of W&B's
    can hold points, not faces: the meshes themselves stand beside it.
    """
    import wandb  # slow to import; only who logs there waits for it

    if "WANDB_SWEEP_ID" not in os.environ:
        wandb.finish()  # the training's
    with account():
        session = wandb.run or wandb.init(
            name=run.name,
            id=run.name,
            group=training_directory(config).name,
            job_type="evaluation",
            dir=run,
            project=config.logger.project,
            mode="offline" if config.logger.offline else None,
            config=asdict(config),
            resume="allow",
        )
    with tempfile.TemporaryDirectory() as folder:  # W&B copies what is logged
        names = [*metrics.mean]
        table = wandb.Table(["scene", *names, "picture", "mesh"])
        shown: dict[str, Any] = {}
        for scene, scores in metrics.scenes.items():
            picture, mesh = _picture(run, scene), _mesh(run, scene)
            table.add_data(
                scene,
                *(scores.get(name) for name in names),
                wandb.Image(str(picture)) if picture else None,
                wandb.Object3D(_points(mesh)) if mesh else None,
            )
            if picture:
                shown[f"test/picture/{scene}"] = wandb.Image(str(picture))
            if mesh:
                path = Path(folder) / f"{file_name(scene)}.glb"
                path.write_bytes(glb_of(mesh))
                shown[f"test/mesh/{scene}"] = wandb.Object3D(str(path))
        means = {f"test/{key}": value for key, value in metrics.mean.items()}
        session.log({**means, **shown, "test/scenes": table})
        session.finish()


def _to_tensorboard(run: Path, metrics: Metrics) -> None:
    """In ``tensorboard/`` of the run, once."""
    from torch.utils.tensorboard import SummaryWriter

    folder = run / "tensorboard"
    if folder.exists():
        return
    with atomic_directory(folder) as temporary, SummaryWriter(str(temporary)) as writer:
        for key, value in metrics.mean.items():
            writer.add_scalar(f"test/{key}", value, 0)
        for scene in metrics.scenes:
            if picture := _picture(run, scene):
                with Image.open(picture) as image:
                    pixels = np.asarray(image.convert("RGB"))
                writer.add_image(f"test/{scene}", pixels, 0, dataformats="HWC")


def _picture(run: Path, scene: str) -> Path | None:
    path = picture_path(run, scene)
    return path if path.exists() else None


def _mesh(run: Path, scene: str) -> trimesh.Trimesh | None:
    """A test scene's mesh, small enough to send; None if there is none, or it is empty."""
    path = mesh_path(run, scene)
    mesh = read_mesh(path) if path.exists() else None
    return at_most(mesh, FACES) if mesh is not None and len(mesh.faces) else None


def _points(mesh: trimesh.Trimesh) -> np.ndarray:
    """The vertices with their colours: x, y, z (metres), r, g, b: [V, 6]."""
    colors = vertex_colors(mesh)
    if colors is None:
        colors = np.full((len(mesh.vertices), 3), 128)
    return np.column_stack([mesh.vertices, colors])
