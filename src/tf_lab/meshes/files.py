"""Mesh files: reading those that others wrote, writing ours."""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path

import numpy as np
import trimesh

from tf_lab.errors import TFLabError
from tf_lab.meshes.glb import FAR, vertex_colors


def read_mesh(path: Path) -> trimesh.Trimesh:
    """A PLY mesh, its vertices and their colours as stored; it may have no faces, or be empty.

    Raises:
        TFLabError: the file is missing, not a PLY, cut short, or holds impossible values.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise TFLabError(f"{path}: cannot be read ({error.strerror})") from error
    try:
        loaded = trimesh.load(BytesIO(content), file_type="ply", process=False)  # no textures
    except Exception as error:  # trimesh raises whatever the damage leads to
        raise TFLabError(
            f"{path}: not a readable PLY mesh ({error}); write it again, of triangles alone"
        ) from error
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
    colors = vertex_colors(loaded) if isinstance(loaded, trimesh.Trimesh) else None
    return trimesh.Trimesh(vertices, faces, vertex_colors=colors, process=False)


def write_mesh(mesh: trimesh.Trimesh, path: Path) -> None:
    """Write a mesh with its colours as binary PLY; one far from the origin in double precision.

    Raises:
        OSError: it cannot be written.
    """
    if not len(mesh.vertices) or np.abs(mesh.vertices).max() <= FAR:
        mesh.export(path, file_type="ply")
        return
    columns = {axis: ("double", "<f8", mesh.vertices[:, i]) for i, axis in enumerate("xyz")}
    colors = vertex_colors(mesh)
    if colors is not None:
        names = ("red", "green", "blue")
        columns |= {name: ("uchar", "u1", colors[:, i]) for i, name in enumerate(names)}
    vertices = np.empty(len(mesh.vertices), [(n, kind) for n, (_, kind, _) in columns.items()])
    for name, (_, _, values) in columns.items():
        vertices[name] = values
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property {kind} {name}" for name, (kind, _, _) in columns.items()),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    text = "".join(f"{line}\n" for line in header)
    path.write_bytes(text.encode() + vertices.tobytes() + faces.tobytes())
