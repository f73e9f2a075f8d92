"""A mesh that can be turned, inside a page."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import trimesh

from tf_lab.meshes.decimate import at_most
from tf_lab.meshes.glb import vertex_colors
from tf_lab.meshes.raycast import CLAY

FACES = 60_000  # enough for a page, about 1 MB
SCRIPT = Path(__file__).with_suffix(".js")


def mesh_view(mesh: trimesh.Trimesh) -> str:
    """A mesh (metres, faces towards free space) with its colours as HTML; "" without faces.

    Where faces can be left out (see `tf_lab.meshes.decimate`), no more than `FACES` stay.
    """
    if not len(mesh.faces):
        return ""
    mesh = at_most(mesh, FACES)
    low, high = mesh.bounds
    size = np.maximum(high - low, 1e-6)
    places = np.round((mesh.vertices - low) / size * 65535).astype("<u2")
    colors = vertex_colors(mesh)
    if colors is None:
        colors = np.tile(np.round(255 * np.array(CLAY)), (len(mesh.vertices), 1))
    parts = {"places": places, "colors": colors.astype("u1"), "faces": mesh.faces.astype("<u4")}
    data = " ".join(
        f"data-{name}='{base64.b64encode(part.tobytes()).decode()}'" for name, part in parts.items()
    )
    shape = ",".join(f"{x:.5f}" for x in size)
    return (
        f"<canvas data-size='{shape}' {data}></canvas><script>{SCRIPT.read_text()}</script>"
        "<p>Drag to turn, shift-drag to move, wheel to come closer.</p>"
    )
