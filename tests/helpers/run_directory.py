"""What every run directory holds."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
import yaml
from PIL import Image

import tf_lab

METRICS = {"acc", "compl", "chamfer", "prec", "recall", "fscore"}


def check_run(run: Path) -> dict[str, Any]:
    """That a run directory holds all of the contract; what its metrics.json says."""
    metrics = json.loads((run / "metrics.json").read_text())
    assert metrics["protocol"] == "transformerfusion"
    assert set(metrics["mean"]) == METRICS
    assert list(metrics["scenes"]) == ["room_2000000"]
    (scores,) = metrics["scenes"].values()
    assert scores == metrics["mean"]  # of one scene
    assert 0 <= scores["fscore"] <= 1
    assert 0 <= scores["acc"] <= 100  # cm, capped at 1 m
    assert scores["chamfer"] == pytest.approx((scores["acc"] + scores["compl"]) / 2)
    mesh = trimesh.load(run / "meshes" / "room_2000000.ply", process=False)
    assert (len(getattr(mesh, "faces", [])) > 0) == (scores["recall"] > 0)
    with Image.open(run / "pictures" / "room_2000000.png") as picture:
        assert np.asarray(picture.convert("L")).std() > 10  # not blank
    config = yaml.safe_load((run / "config.yaml").read_text())
    assert "${" not in (run / "config.yaml").read_text()  # resolved
    origin = json.loads((run / "run.json").read_text())
    assert set(origin) >= {"commit", "command", "python", "packages", "machine", "checkpoint"}
    assert origin["tf_lab"] == tf_lab.__version__
    assert origin["packages"]["torch"].split("+")[0] == torch.__version__.split("+")[0]
    assert origin["training"]["config"]["seed"] == config["seed"]
    return metrics
