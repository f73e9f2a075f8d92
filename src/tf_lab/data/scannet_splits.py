"""What belongs to ScanNet beside its frames: the v2 splits, the official meshes and their labels.

A download is ``scans/<scene>/`` (train and val) and ``scans_test/<scene>/``, with
``<scene>_vh_clean_2.ply`` and ``<scene>_vh_clean_2.labels.ply`` (not of test scenes) in each.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from tf_lab.errors import TFLabError
from tf_lab.support.text import read_text

SPLITS = ("train", "val", "test")  # 1201, 312 and 100 scenes
WALL, FLOOR = 1, 2  # NYU40

_SCENE = re.compile(r"scene\d{4}_\d\d")
_MAX_HEADER = 65536  # bytes
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4",
    "float": "<f4", "double": "<f8", "int8": "i1", "uint8": "u1", "int16": "<i2", "uint16": "<u2",
    "int32": "<i4", "uint32": "<u4", "float32": "<f4", "float64": "<f8",
}  # fmt: skip


def split_scenes(root: Path, split: str) -> list[str]:
    """The scenes of an official split, sorted.

    Args:
        root: of the download; a ``scannetv2_<split>.txt`` in it, in its parent or in its
            ``Tasks/Benchmark`` (a clone of ScanNet's repository) is used; else the official one.
        split: train, val or test.

    Raises:
        TFLabError: there is no such split, or the user's file is not a list of scenes.
    """
    if split not in SPLITS:
        raise TFLabError(f"split={split}: ScanNet has {', '.join(SPLITS)}")
    file = f"scannetv2_{split}.txt"
    given = (folder / file for folder in (root, root.parent, root / "Tasks" / "Benchmark"))
    path = next((p for p in given if p.is_file()), Path(__file__).parent / "splits" / file)
    cure = "it holds one scene a line, as scene0000_00; remove it to use the official split"
    scenes = read_text(path, cure).split()
    wrong = [scene for scene in scenes if not _SCENE.fullmatch(scene)]
    if wrong or not scenes:
        found = f"{wrong[0][:40]!r} is no scene" if wrong else "no scene in it"
        raise TFLabError(f"{path}: {found}; {cure}")
    return sorted(set(scenes))


def find_scene(root: Path, scene: str) -> Path:
    """The folder of a scene.

    Args:
        root: holds ``scans/`` and ``scans_test/``, or the scenes' folders themselves.
        scene: its id, as scene0000_00.

    Raises:
        TFLabError: it is not there.
    """
    folders = [root / "scans" / scene, root / "scans_test" / scene, root / scene]
    for folder in folders:
        if folder.is_dir():
            return folder
    raise TFLabError(
        f"{folders[0]}: no such folder, nor is {scene} in scans_test/ or in {root} itself; "
        "download the scene, or give the folder that holds scans/"
    )


def official_mesh(scene: Path) -> Path | None:
    """ScanNet's own mesh of a scene (its folder or `.sens` file); None: it is not there."""
    return _beside(scene, "_vh_clean_2.ply")


def structure_labels(scene: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """What of a scene's official mesh is floor or wall, by ScanNet's annotation.

    Args:
        scene: its folder or `.sens` file.

    Returns:
        The vertices float64 [V, 3], metres in ScanNet's world, and bool [V]; None: no labels.

    Raises:
        TFLabError: the file of the labels is damaged.
    """
    path = _beside(scene, "_vh_clean_2.labels.ply")
    if path is None:
        return None
    try:
        vertices = _read_vertices(path)
        points = np.stack([vertices[axis] for axis in "xyz"], 1).astype(np.float64)
        labels = vertices["label"]
    except (OSError, ValueError) as error:
        raise TFLabError(f"{path}: cannot be read ({error}); download it again") from error
    if not np.isfinite(points).all():
        raise TFLabError(f"{path}: a vertex is NaN or infinite; download it again")
    return points, np.isin(labels, (WALL, FLOOR))


def _beside(scene: Path, ending: str) -> Path | None:
    """The scene's file of that ending, if it exists."""
    name = scene.resolve().name if scene.is_dir() else scene.stem
    path = (scene if scene.is_dir() else scene.parent) / f"{name}{ending}"
    return path if path.is_file() else None


def _read_vertices(path: Path) -> np.ndarray:
    """The vertices of a binary PLY (little-endian, as ScanNet's) as a structured array [V].

    Raises:
        ValueError: it is something else, or cut short.
    """
    with path.open("rb") as file:
        header, end, _ = file.read(_MAX_HEADER).partition(b"end_header\n")
        words = [line.split() for line in header.decode("ascii", "replace").splitlines()]
        if not end or words[:2] != [["ply"], ["format", "binary_little_endian", "1.0"]]:
            raise ValueError("not a binary little-endian PLY file")
        declared = [word for word in words[2:] if word and word[0] in ("element", "property")]
        starts = [i for i, word in enumerate(declared) if word[0] == "element"]
        if not starts or declared[0][1:2] != ["vertex"] or len(declared[0]) != 3:
            raise ValueError("the vertices do not come first")
        properties = declared[1 : starts[1] if len(starts) > 1 else None]
        if not properties or not all(len(word) == 3 and word[1] in _TYPES for word in properties):
            raise ValueError("the vertices' properties are not numbers")
        dtype = np.dtype([(word[2], _TYPES[word[1]]) for word in properties])
        count, room = int(declared[0][2]), path.stat().st_size - len(header) - len(end)
        if not 0 <= count * dtype.itemsize <= room:
            raise ValueError(f"too short for {count} vertices")
        file.seek(len(header) + len(end))
        return np.fromfile(file, dtype, count)
