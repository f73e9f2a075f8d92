"""A page with finished meshes, side by side under one camera."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from tf_lab.errors import TFLabError
from tf_lab.evaluation.truth import Truth
from tf_lab.meshes.glb import vertex_colors
from tf_lab.support.colors import error_colors
from tf_lab.viewer.html import legend_of
from tf_lab.viewer.paint import clay
from tf_lab.viewer.scene import Drawing, look_from_above
from tf_lab.viewer.serve import LocalServer

GAP = 0.5  # metres between meshes
WHOLE = (0, 0, 0)
MODES = ("as stored", "error", "clay")


def show_meshes(
    server: LocalServer, meshes: Mapping[str, trimesh.Trimesh], groundtruth: trimesh.Trimesh | None
) -> None:
    """Make the page of meshes (metres) by name, beside the ground truth if there is one.

    Raises:
        TFLabError: all are empty.
    """
    every = dict(meshes) if groundtruth is None else {**meshes, "ground truth": groundtruth}
    full = [mesh.bounds for mesh in every.values() if len(mesh.faces)]
    if not full:
        raise TFLabError(f"{', '.join(meshes)}: there is no surface to look at")
    bounds = np.stack([np.min([low for low, _ in full], 0), np.max([high for _, high in full], 0)])
    step = bounds[1, 0] - bounds[0, 0] + GAP
    truth = None if groundtruth is None else Truth(groundtruth)
    drawings = {}
    for number, name in enumerate(every):
        shift = np.array([number * step, 0, 0])
        drawings[name] = Drawing(server, f"/{number}", shift)
        place = np.array([*bounds.mean(0)[:2], bounds[1, 2] + 0.2])
        server.scene.add_label(f"/{number}/name", Path(name).name, position=place)

    def paint(mode: str) -> None:
        for name, mesh in every.items():
            colors = _colors(mesh, mode, truth)
            drawings[name].draw_piece(WHOLE, mesh if len(mesh.faces) else None, colors)

    modes = MODES if truth is not None else tuple(mode for mode in MODES if mode != "error")
    color = server.gui.add_dropdown("Colour", modes)
    legend = server.gui.add_html("")

    @color.on_update
    def _(_: Any) -> None:
        paint(color.value)
        legend.content = legend_of(color.value, 0)

    paint(modes[0])
    row = bounds + np.array([[0, 0, 0], [step * (len(every) - 1), 0, 0]])
    look_from_above(server, row)


def _colors(mesh: trimesh.Trimesh, mode: str, truth: Truth | None) -> np.ndarray:
    """Of the vertices, uint8 [V, 3]."""
    if mode == "error" and truth is not None:
        return error_colors(truth.distances(np.asarray(mesh.vertices)))
    stored = vertex_colors(mesh) if mode == "as stored" else None
    return clay(mesh) if stored is None else stored
