"""What of an evaluation is logged where its training is: scores, pictures, meshes."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from helpers.made_up_runs import write_run
from tf_lab.config.compose import compose_config
from tf_lab.config.schema import TrainConfig
from tf_lab.evaluation.scores import Metrics, read_metrics
from tf_lab.meshes.glb import read_glb
from tf_lab.training.evaluation_log import log_run

ROOM = "room_2000000"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A made-up run of two scenes, one of them with a mesh and a picture."""
    run = write_run(tmp_path, "views=4", 0, [0.5, 0.7])
    for folder in ("meshes", "pictures"):
        (run / folder).mkdir()
    trimesh.creation.box((1, 2, 3)).export(run / "meshes" / f"{ROOM}.ply")
    Image.new("RGB", (8, 6), (255, 0, 0)).save(run / "pictures" / f"{ROOM}.png")
    return run


def logged(logger: str, run: Path) -> None:
    config: TrainConfig = compose_config("train", f"logger={logger}", "views=4")
    metrics = read_metrics(run)
    assert isinstance(metrics, Metrics)
    log_run(replace(config, output=str(run.parents[1])), run, metrics)


def test_with_tensorboard(run: Path) -> None:
    logged("tensorboard", run)
    logged("tensorboard", run)  # once is enough
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    found = EventAccumulator(str(run / "tensorboard")).Reload()
    (score,) = found.Scalars("test/fscore")
    assert score.value == pytest.approx(0.6)
    (image,) = found.Images(f"test/{ROOM}")
    assert (image.width, image.height) == (8, 6)


def test_without_a_logger(run: Path) -> None:
    before = {*run.rglob("*")}
    logged("csv", run)
    assert {*run.rglob("*")} == before


@pytest.mark.slow
def test_with_wandb_offline(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WANDB_SILENT", "true")
    monkeypatch.delenv("WANDB_SWEEP_ID", raising=False)
    logged("wandb_offline", run)
    (media,) = run.glob("wandb/offline-run-*/files/media")
    (table,) = (media / "table" / "test").glob("scenes*.table.json")
    found: dict[str, Any] = json.loads(table.read_text())
    rows = [dict(zip(found["columns"], row, strict=True)) for row in found["data"]]
    assert [row["fscore"] for row in rows] == pytest.approx([0.5, 0.7])
    assert [(row["picture"], row["mesh"]) for row in rows] == [("Image", "Object3D"), (None, None)]
    (path,) = media.rglob("*.glb")
    mesh = read_glb(path)
    np.testing.assert_allclose(np.sort(mesh.extents), [1, 2, 3], atol=1e-5)
    (picture,) = media.rglob("*.png")
    assert picture.stat().st_size > 50
