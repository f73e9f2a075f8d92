"""Surfaces that were meshed in parts, as one without seams."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Part = tuple[np.ndarray, np.ndarray]  # vertices [V, 3], faces int [F, 3]


def weld(parts: Sequence[Part], tolerance: float = 0.0, borders: float | None = None) -> Part:
    """One mesh of some parts, in which vertices at the same place are one.

    Args:
        parts: one or more; a single one stays as it is.
        tolerance: vertices are at the same place if they round to the same multiple of it; 0: if
            they are equal.
        borders: parts meet only in planes of constant x, y or z at multiples of this; other
            vertices stay as they are. None: they may meet anywhere.

    Returns:
        Its vertices and its faces, those that have collapsed left out.
    """
    if len(parts) == 1:
        return parts[0]
    start = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + first for (_, faces), first in zip(parts, start, strict=False)])
    shared = np.ones(len(vertices), bool)
    if borders is not None:
        shared = (vertices % borders == 0).any(1)
    places = vertices[shared]
    if tolerance > 0:
        places = np.round(places / tolerance).astype(np.int64)
    _, first, same = np.unique(places, axis=0, return_index=True, return_inverse=True)
    alone = len(vertices) - len(places)
    number = np.empty(len(vertices), np.int64)
    number[~shared] = np.arange(alone)
    number[shared] = alone + same.reshape(-1)
    a, b, c = (faces := number[faces]).T
    vertices = np.concatenate([vertices[~shared], vertices[shared][first]])
    return vertices, faces[(a != b) & (b != c) & (c != a)]
