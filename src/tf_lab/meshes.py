"""Reading meshes that others wrote."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import trimesh

from tf_lab.errors import TFLabError


def read_mesh(path: Path) -> trimesh.Trimesh:
    """A PLY mesh with its vertices as stored; it may have no faces, or be empty.

    Raises:
        TFLabError: the file is missing, not a PLY, cut short, or holds impossible values.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise TFLabError(f"{path}: cannot be read ({error.strerror})") from error
    try:
        loaded = trimesh.load(path, file_type="ply", process=False)
    except Exception as error:  # trimesh raises whatever the damage leads to
        raise TFLabError(f"{path}: not a readable PLY mesh ({error}); write it again") from error
    vertices = np.asarray(getattr(loaded, "vertices", np.zeros((0, 3))), np.float64)
    faces = np.asarray(getattr(loaded, "faces", np.zeros((0, 3))), np.int64)
    # trimesh takes an ASCII file that was cut short for a smaller mesh.
    declared = dict(re.findall(rb"element (vertex|face) (\d+)", content.split(b"end_header")[0]))
    if len(vertices) < int(declared.get(b"vertex", 0)) or len(faces) < int(
        declared.get(b"face", 0)
    ):
        raise TFLabError(f"{path}: fewer vertices or faces than its header says; write it again")
    if not np.isfinite(vertices).all():
        raise TFLabError(f"{path}: a vertex is NaN or infinite; remove such vertices")
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise TFLabError(f"{path}: a face refers to a vertex that does not exist; write it again")
    return trimesh.Trimesh(vertices, faces, process=False)
