"""Meshes as GLB (glTF 2.0), as Blender, browsers and the system's viewers open them.

glTF's up is y and its vertex colours are linear; ours are z and sRGB.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.exchange.gltf import export_glb
from trimesh.visual import ColorVisuals

from tf_lab.errors import TFLabError

Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
FAR = 1000.0  # metres; single precision is worth 0.1 mm there


def vertex_colors(mesh: trimesh.Trimesh) -> np.ndarray | None:
    """The colours of a mesh's vertices: sRGB, uint8 [V, 3]; None without any."""
    if isinstance(mesh.visual, ColorVisuals) and mesh.visual.kind == "vertex":
        return np.asarray(mesh.visual.vertex_colors)[:, :3]
    return None


def glb_of(mesh: trimesh.Trimesh, place: np.ndarray = Y_UP) -> bytes:
    """A mesh (metres, z up) with its colours as a GLB file.

    Args:
        mesh: may be empty.
        place: [4, 4], where it goes in the file's world; it is the node's matrix, of double
            precision, and so is the way to a mesh far from the origin.
    """
    far = len(mesh.vertices) > 0 and np.abs(mesh.vertices).max() > FAR
    center = mesh.bounds.mean(0) if far else np.zeros(3)
    colors = vertex_colors(mesh)
    linear = None if colors is None else to_linear(colors)
    moved = trimesh.Trimesh(mesh.vertices - center, mesh.faces, vertex_colors=linear, process=False)
    transform = place @ trimesh.transformations.translation_matrix(center)
    scene = trimesh.Scene()
    if len(mesh.faces):
        scene.add_geometry(moved, "mesh", transform=transform)
    return bytes(export_glb(scene, tree_postprocessor=_matt))


def _matt(tree: dict[str, Any]) -> None:
    """Neither metal nor gloss, which is what a file without a material asks for."""
    surface = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    tree["materials"] = [{"pbrMetallicRoughness": surface}]
    for mesh in tree.get("meshes", []):
        for primitive in mesh["primitives"]:
            primitive["material"] = 0


def read_glb(path: Path) -> trimesh.Trimesh:
    """What `glb_of` wrote, or another GLB as one mesh: metres, z up.

    Raises:
        TFLabError: the file is missing or no GLB.
    """
    try:
        scene = trimesh.load_scene(path, file_type="glb", process=False)
        for mesh in scene.geometry.values():
            colors = mesh.visual.vertex_attributes.get("color")  # kept beside a material
            if colors is not None:
                mesh.visual = ColorVisuals(mesh, vertex_colors=to_srgb(colors[:, :3]))
        if not scene.geometry:
            return trimesh.Trimesh()
        return scene.to_mesh().apply_transform(np.linalg.inv(Y_UP))
    except Exception as error:  # trimesh raises whatever the damage leads to
        raise TFLabError(f"{path}: not a readable GLB mesh ({error}); write it again") from error


def to_linear(colors: np.ndarray) -> np.ndarray:
    """SRGB (IEC 61966-2-1), uint8, as linear light, uint8."""
    x = colors / 255
    return _bytes(np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4))


def to_srgb(colors: np.ndarray) -> np.ndarray:
    """Linear light, uint8, as sRGB, uint8."""
    x = colors / 255
    return _bytes(np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055))


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.round(255 * values).astype(np.uint8)
