"""Smaller meshes."""

from __future__ import annotations

import contextlib
from importlib.util import find_spec

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from tf_lab.errors import TFLabError
from tf_lab.meshes.glb import vertex_colors


def check_share(share: float) -> None:
    """That meshes can be decimated to a share of their faces.

    Raises:
        TFLabError: fast-simplification is not installed.
    """
    if share < 1 and find_spec("fast_simplification") is None:
        raise TFLabError("decimate= needs fast-simplification: pip install -e '.[decimate]'")


def at_most(mesh: trimesh.Trimesh, faces: int) -> trimesh.Trimesh:
    """A mesh with about so many faces at most; as it is where faces cannot be left out."""
    with contextlib.suppress(TFLabError):
        return decimated(mesh, faces / max(len(mesh.faces), 1))
    return mesh


def decimated(mesh: trimesh.Trimesh, share: float) -> trimesh.Trimesh:
    """A mesh with about a share of its faces (quadric error metrics, Garland & Heckbert 1997).

    Its vertices have the colours of those that were nearest.

    Raises:
        TFLabError: fast-simplification is not installed.
    """
    if share >= 1 or not len(mesh.faces):
        return mesh
    check_share(share)
    smaller = mesh.simplify_quadric_decimation(percent=1 - share)
    colors = vertex_colors(mesh)
    if colors is None:
        return trimesh.Trimesh(smaller.vertices, smaller.faces, process=False)
    nearest = cKDTree(np.asarray(mesh.vertices)).query(np.asarray(smaller.vertices))[1]
    return trimesh.Trimesh(
        smaller.vertices, smaller.faces, vertex_colors=colors[nearest], process=False
    )
