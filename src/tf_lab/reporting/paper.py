"""The paper's numbers, from ``paper.yaml``: scores on ScanNet, times on an RTX 3090."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tf_lab.evaluation.scores import Scores

OURS = "Ours"


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper.

    Attributes:
        source: its LaTeX label and caption.
        groups: metrics by row, the rows between two rules a group; ours is the last.
    """

    source: str
    groups: tuple[dict[str, Scores], ...]


def _table(held: dict[str, Any], columns: list[str]) -> PaperTable:
    groups = [
        {row: dict(zip(columns, values, strict=True)) for row, values in group.items()}
        for group in held["groups"]
    ]
    return PaperTable(held["source"], tuple(groups))


_HELD = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
MAIN = _table(_HELD["main"], _HELD["columns"])
INPUTS = _table(_HELD["inputs"], _HELD["columns"])
BASELINES = tuple(MAIN.groups[0])
ABLATIONS = (*MAIN.groups[1], *INPUTS.groups[0])
SCORES: dict[str, Scores] = {
    row: scores
    for table in (MAIN, INPUTS)
    for group in table.groups
    for row, scores in group.items()
}

# The rows of the chart of F-score against K, by views kept a voxel.
ATTENTION = {4: "Ours: 4 images", 8: "Ours: 8 images", 16: OURS}
RANDOM = {4: "Ours: 4 images, RND", 8: "Ours: 8 images, RND", 16: "Ours: 16 images, RND"}
DIVERSE = {k: f"Ours: {k} images, diverse (ours)" for k in ATTENTION}  # not the paper's

FRAME_MS: dict[str, float] = _HELD["frame"]["ms"]
CHUNK_MS: dict[str, float] = _HELD["chunk"]["ms"]
FPS: dict[int, float] = _HELD["speed"]["fps"]
