"""The evaluation protocol that the authors of TransformerFusion released: files in, metrics out.

Published layout::

    predictions/<scene>.ply
    groundtruth/<scene>/mesh_gt.ply          its vertices are the ground-truth points
    groundtruth/<scene>/occlusion_mask.npy   [X, Y, Z], 1 where never observed
    groundtruth/<scene>/world2grid.txt       4x4, world metres to voxel centres
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from tf_lab.errors import TFLabError
from tf_lab.evaluation.metrics import THRESHOLD, Comparison, visibility
from tf_lab.evaluation.scores import Scores, mean_scores, score
from tf_lab.meshes.files import read_mesh
from tf_lab.support.arrays import read_array
from tf_lab.support.layout import GROUNDTRUTH_MESH, OCCLUSION_MASK, WORLD2GRID
from tf_lab.support.text import read_numbers
from tf_lab.support.words import counted

PROTOCOL = "transformerfusion"
LAYOUT = "the published layout needs it"
FILES = (GROUNDTRUTH_MESH, OCCLUSION_MASK, WORLD2GRID)  # of a scene
MESHES = (".ply", ".obj", ".glb", ".gltf", ".stl", ".off")  # what others write
SAMPLES = 200_000  # points on every predicted mesh, whatever its resolution
CLEAR = 2.5  # a factor between the sizes of prediction and ground truth that nobody means
UNITS = {1000: "millimetres", 100: "centimetres", 39.37: "inches", 3.28: "feet"}  # in a metre


@dataclass(frozen=True)
class PublishedGroundTruth:
    """mesh in metres; occlusion_mask [X, Y, Z]; world2grid [4, 4] (see `visibility`)."""

    mesh: trimesh.Trimesh
    occlusion_mask: np.ndarray
    world2grid: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """The ground-truth points, [G, 3], metres: the vertices of the mesh."""
        return np.asarray(self.mesh.vertices)

    def moved(self, transform: np.ndarray) -> PublishedGroundTruth:
        """The same after a transform [4, 4] of the world."""
        world2grid = self.world2grid @ np.linalg.inv(transform)
        return PublishedGroundTruth(
            self.mesh.copy().apply_transform(transform), self.occlusion_mask, world2grid
        )


def read_groundtruth(directory: Path) -> PublishedGroundTruth:
    """The ground truth of one scene in the published layout.

    Raises:
        TFLabError: a file is missing, damaged or of a wrong shape.
    """
    mesh = read_mesh(directory / GROUNDTRUTH_MESH)
    if len(mesh.vertices) == 0:
        raise TFLabError(f"{directory / GROUNDTRUTH_MESH}: has no vertex; prepare the scene again")
    path = directory / OCCLUSION_MASK
    mask = np.array(read_array(path, LAYOUT))
    if mask.ndim != 3 or 0 in mask.shape or mask.dtype.kind not in "biuf":
        raise TFLabError(
            f"{path}: {mask.dtype} of shape {mask.shape}, expected numbers in three dimensions"
        )
    if not np.isfinite(mask).all():
        raise TFLabError(f"{path}: holds NaN or infinity")
    return PublishedGroundTruth(mesh, mask, _read_world2grid(directory / WORLD2GRID))


def _read_world2grid(path: Path) -> np.ndarray:
    """A transform [4, 4]. Raises TFLabError: it is none."""
    numbers = read_numbers(path, LAYOUT)
    if len(numbers) != 16:
        raise TFLabError(f"{path}: {len(numbers)} numbers, expected 4x4")
    matrix = np.array(numbers).reshape(4, 4)
    if not np.isfinite(matrix).all():
        raise TFLabError(f"{path}: holds NaN or infinity")
    if not np.allclose(matrix[3], (0, 0, 0, 1)) or abs(np.linalg.det(matrix)) < 1e-12:
        raise TFLabError(f"{path}: not an invertible matrix with last row 0 0 0 1")
    return matrix


def evaluate_scene(
    prediction: str | Path | trimesh.Trimesh | None,
    groundtruth_dir: str | Path,
    seed: int = 0,
    metrics: Sequence[Any] = (),
) -> Scores:
    """Scores of one reconstruction; distances in cm.

    Args:
        prediction: a PLY file, a mesh in metres, or None. A missing file counts as None.
        groundtruth_dir: the scene's folder of the published layout.
        seed: seed of the surface samples.
        metrics: settings of metrics beyond the paper's.

    Raises:
        TFLabError: a file is damaged, or the ground truth is incomplete.
    """
    truth = read_groundtruth(Path(groundtruth_dir))
    if isinstance(prediction, str | Path):
        prediction = _read_prediction(Path(prediction))
    return score(compared(prediction, truth, seed), metrics)


def compared(
    mesh: trimesh.Trimesh | None, truth: PublishedGroundTruth, seed: int = 0
) -> Comparison | None:
    """A prediction beside the ground truth; None if it is missing or empty.

    Raises:
        TFLabError: a vertex is no number.
    """
    if mesh is not None and not np.isfinite(mesh.vertices).all():
        raise TFLabError("the predicted mesh: a vertex is NaN or infinite; remove such vertices")
    points, faces = samples(mesh, seed)
    if len(points) == 0:
        return None
    visible = visibility(points, truth.occlusion_mask, truth.world2grid)
    return Comparison(points, visible, truth.points, mesh, faces, truth.mesh)


def samples(mesh: trimesh.Trimesh | None, seed: int = 0) -> tuple[np.ndarray, np.ndarray | None]:
    """The points [P, 3] that stand for a prediction, and the face [P] that each is on, if any.

    Of a surface `SAMPLES`, uniform over its area; of a point cloud (no faces) its own points, at
    most as many; none of an empty mesh or one without area.
    """
    if mesh is not None and is_point_cloud(mesh):
        chosen = np.random.default_rng(seed).permutation(len(mesh.vertices))[:SAMPLES]
        return np.asarray(mesh.vertices)[chosen], None
    if mesh is None or not mesh.area > 0:
        return np.zeros((0, 3)), None
    points, faces = trimesh.sample.sample_surface(mesh, SAMPLES, seed=seed)[:2]
    return np.asarray(points), np.asarray(faces)


def is_point_cloud(mesh: trimesh.Trimesh) -> bool:
    """Whether there are points, but no surface."""
    return len(mesh.vertices) > 0 and len(getattr(mesh, "faces", ())) == 0


def _read_prediction(path: Path) -> trimesh.Trimesh | None:
    return read_mesh(path) if path.exists() else None


def _other_file(predictions: Path, name: str) -> Path | None:
    """A file of a scene's name in another format."""
    found = (path for path in sorted(predictions.iterdir()) if path.is_file())
    return next((p for p in found if p.stem == name and p.suffix.lower() in MESHES), None)


def wrong_scale(points: np.ndarray, truth: np.ndarray) -> str | None:
    """By what factor a prediction [P, 3] is larger or smaller than [G, 3], if by a clear one."""
    # a few far points say nothing about the size of the rest
    sizes = [np.ptp(np.quantile(p, (0.02, 0.98), axis=0), axis=0) for p in (points, truth)]
    predicted, true = (float(np.linalg.norm(size)) for size in sizes)
    if predicted == 0 or true == 0 or 1 / CLEAR < predicted / true < CLEAR:
        return None
    ratio = predicted / true
    unit = min(UNITS, key=lambda factor: abs(np.log(ratio / factor)))
    known = abs(np.log(ratio / unit)) < np.log(1.25)  # no reconstruction is quite whole
    times, guess = (unit, f", as if in {UNITS[unit]}") if known else (float(f"{ratio:.2g}"), "")
    return f"about {times:g} times as large as the ground truth{guess}; both must be in metres"


def scene_names(groundtruth: Path) -> list[str]:
    """The scenes of a ground truth in the published layout: its folders, sorted.

    Raises:
        TFLabError: there is no such folder or no scene in it.
    """
    if not groundtruth.is_dir():
        raise TFLabError(f"{groundtruth}: no such folder; give the folder of all ground truths")
    names = [p.name for p in groundtruth.iterdir() if p.is_dir() and not p.name.startswith(".")]
    if not names:
        raise TFLabError(f"{groundtruth}: no scene folder in it; expected <scene>/mesh_gt.ply")
    return sorted(names)


def check_groundtruth(folder: Path, scenes: Iterable[str]) -> None:
    """That a folder in the published layout has the ground truth of these scenes.

    Raises:
        TFLabError: there is no such folder, or it lacks a file of one.
    """
    scene_names(folder)
    wanted = list(scenes)
    missing = [n for n in wanted if not all((folder / n / file).is_file() for file in FILES)]
    if missing:
        raise TFLabError(
            f"groundtruth={folder}: lacks that of {len(missing)} of {counted(len(wanted), 'scene')}"
            f", the first: {missing[0]}; a scene's is {missing[0]}/{{{','.join(FILES)}}}"
        )


def groundtruth_digest(folder: Path, scenes: Iterable[str] = ()) -> str:
    """A hash of these scenes' files of the published layout (none given: of all), wherever they
    lie.

    Raises:
        TFLabError: there is no scene in the folder, or a file cannot be read.
    """
    digest, names = hashlib.sha256(), sorted(scenes) or scene_names(folder)
    for path in (folder / name / file for name in names for file in FILES):
        try:
            with path.open("rb") as file:
                content = hashlib.file_digest(file, "sha256").hexdigest()
        except FileNotFoundError:  # of a scene that may not be used
            continue
        except OSError as error:
            raise TFLabError(f"{path}: cannot be read ({error.strerror})") from error
        digest.update(f"{path.parent.name}/{path.name} {content}\n".encode())
    return digest.hexdigest()[:16]


def evaluate(
    predictions: Path,
    groundtruth: Path,
    seed: int = 0,
    track: Callable[[list[str]], Iterable[str]] = iter,
    metrics: Sequence[Any] = (),
) -> dict[str, Any]:
    """Evaluate every scene of the ground truth.

    Args:
        predictions: folder of <scene>.ply; a missing one scores as an empty mesh.
        groundtruth: folder of <scene>/ in the published layout.
        seed: seed of the surface samples, for each scene alike.
        track: wraps the list of scenes, for instance in a progress bar.
        metrics: settings of metrics beyond the paper's.

    Returns:
        ``protocol``, ``mean`` and ``scenes`` (metrics.json), ``settings``, ``missing`` (the scenes
        without a prediction) and ``empty`` (those with one that has no surface), both scored as
        such, ``point_clouds`` (those predicted as points, without a surface), ``unknown`` (meshes
        of no scene), ``wrong_scale`` (scene -> by what factor) and ``failed`` (scene -> message of
        those that could not be evaluated; the mean leaves them out, so a caller must not pass over
        them).

    Raises:
        TFLabError: a folder is missing, or no scene at all could be evaluated.
    """
    if not predictions.is_dir():
        raise TFLabError(f"{predictions}: no such folder; give the folder of <scene>.ply files")
    names = scene_names(groundtruth)
    given = {
        path.stem: path.name for path in predictions.iterdir() if path.suffix.lower() in MESHES
    }
    if not given.keys() & set(names):
        instead = f", but {min(given.values())}" if given else ""
        raise TFLabError(
            f"{predictions}: no mesh of {counted(len(names), 'scene')} in {groundtruth}, such as "
            f"{names[0]}.ply{instead}; a mesh has its scene's name"
        )
    scenes: dict[str, Scores] = {}
    failed: dict[str, str] = {}
    missing, empty, point_clouds, scales = [], [], [], {}
    for name in track(names):
        try:
            truth = read_groundtruth(groundtruth / name)
            mesh = _read_prediction(predictions / f"{name}.ply")
            if mesh is None and (other := _other_file(predictions, name)):
                cure = "rename" if other.suffix.lower() == ".ply" else "convert"
                raise TFLabError(f"{other}: predictions are read from {name}.ply; {cure} it")
            found = compared(mesh, truth, seed)
            scenes[name] = score(found, metrics)
            if mesh is None:
                missing.append(name)
            elif found is None:
                empty.append(name)
            elif is_point_cloud(mesh):
                point_clouds.append(name)
            if found and (remark := wrong_scale(found.points, truth.points)):
                scales[name] = remark
        except TFLabError as error:
            failed[name] = str(error)
    if not scenes:
        raise TFLabError("no scene could be evaluated: " + "; ".join(failed.values()))
    return {
        "protocol": PROTOCOL,
        "mean": mean_scores(scenes.values()),
        "scenes": scenes,
        "settings": {"seed": seed, "threshold_cm": 100 * THRESHOLD, "n_points": SAMPLES},
        "missing": missing,
        "empty": empty,
        "point_clouds": point_clouds,
        "unknown": sorted(given[name] for name in given.keys() - set(names)),
        "wrong_scale": scales,
        "failed": failed,
    }
