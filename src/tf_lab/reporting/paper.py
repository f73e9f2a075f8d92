"""The paper's numbers, from ``paper.yaml``: scores on ScanNet, times on an RTX 3090."""

from __future__ import annotations

from pathlib import Path

import yaml

from tf_lab.evaluation.scores import Scores

OURS = "Ours"


def _table(groups: list[dict[str, list[float]]], columns: list[str]) -> list[dict[str, Scores]]:
    """Metrics by row, the rows between two rules of the paper's table a group; ours is the last."""
    return [
        {row: dict(zip(columns, values, strict=True)) for row, values in group.items()}
        for group in groups
    ]


_HELD = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
MAIN = _table(_HELD["main"]["groups"], _HELD["columns"])
INPUTS = _table(_HELD["inputs"]["groups"], _HELD["columns"])
ABLATIONS = (*MAIN[1], *INPUTS[0])
SCORES: dict[str, Scores] = {
    row: scores for table in (MAIN, INPUTS) for group in table for row, scores in group.items()
}

# The rows of the chart of F-score against K, by views kept a voxel.
ATTENTION = {4: "Ours: 4 images", 8: "Ours: 8 images", 16: OURS}
RANDOM = {4: "Ours: 4 images, RND", 8: "Ours: 8 images, RND", 16: "Ours: 16 images, RND"}
DIVERSE = {k: f"Ours: {k} images, diverse (ours)" for k in ATTENTION}  # not the paper's

FRAME_MS: dict[str, float] = _HELD["frame"]["ms"]
CHUNK_MS: dict[str, float] = _HELD["chunk"]["ms"]
FPS: dict[int, float] = _HELD["speed"]["fps"]
