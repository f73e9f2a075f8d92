"""Pictures of rooms and training curves, without a GPU or a display.

Meshes are ray-cast (embree) as clay: soft light from the upper left, ambient occlusion, and walls
seen from behind left out, so that one looks into a room from above. Faces must point into free
space, as those of the ground truth and of the mesher do.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from tf_lab.errors import TFLabError
from tf_lab.evaluation.metrics import distances
from tf_lab.files import atomic_path

CLAY = (0.66, 0.74, 0.84)
FINE = 2  # rays a pixel along each axis
LIGHT = np.array([-0.45, -0.35, 0.85])
AMBIENT_RAYS = 12
AMBIENT_REACH = 0.6  # metres: what is farther away casts no ambient shadow
ERROR_SCALE = 0.15  # metres at the end of the error panel's colour bar
ERROR_COLORS = "YlOrRd"
DPI = 150


@dataclass(frozen=True)
class Hits:
    """What a camera sees of a mesh, `FINE`^2 samples a pixel.

    Attributes:
        shape: (height, width) of the samples' grid.
        samples: int [N, 2], row and column of those that meet the mesh.
        points: [N, 3] where they do, metres.
        triangles: int [N, 3], vertices of the face met.
        brightness: [N], of a white surface there.
    """

    shape: tuple[int, int]
    samples: np.ndarray
    points: np.ndarray
    triangles: np.ndarray
    brightness: np.ndarray


def overview_camera(
    bounds: np.ndarray, size: tuple[int, int] = (640, 480), cut: float = 0.5
) -> tuple[np.ndarray, np.ndarray, float]:
    """A bird's-eye view of a room without its ceiling, filled by the room.

    Args:
        bounds: [2, 3] lower and upper corner, metres, z up.
        size: (width, height) of the picture, pixels.
        cut: metres taken off the top.

    Returns:
        K [3, 3], world_T_cam [4, 4] and the height (m) of the cut, for `render_mesh`.
    """
    lower, upper = np.asarray(bounds, np.float64)
    ceiling = max(upper[2] - cut, (lower[2] + upper[2]) / 2)
    top = np.array([upper[0], upper[1], ceiling])
    # The long side lies across the picture; 25 degrees off the axis shows two walls.
    heading = math.radians(25 if upper[0] - lower[0] >= upper[1] - lower[1] else 115)
    pitch = math.radians(52)
    right = np.array([math.cos(heading), math.sin(heading), 0.0])
    ahead = np.array([-right[1], right[0], 0.0])
    forward = math.cos(pitch) * ahead - math.sin(pitch) * np.array([0.0, 0.0, 1.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    corners = np.array(np.meshgrid(*np.stack([lower, top], axis=1))).reshape(3, -1).T
    center = (lower + top) / 2
    local = (corners - center) @ rotation
    distance = 2.2 * float(np.linalg.norm(top - lower))  # far enough for a mild perspective
    plane = local[:, :2] / (local[:, 2:] + distance)
    low, high = plane.min(0), plane.max(0)
    focal = 0.96 * float(np.min(np.array(size) / (high - low)))
    K = np.diag([focal, focal, 1.0])
    K[:2, 2] = (np.array(size) - 1) / 2 - focal * (low + high) / 2
    world_T_cam = np.eye(4)
    world_T_cam[:3, :3] = rotation
    world_T_cam[:3, 3] = center - distance * forward
    return K, world_T_cam, float(ceiling)


def render_mesh(
    mesh: trimesh.Trimesh,
    K: np.ndarray,
    world_T_cam: np.ndarray,
    size: tuple[int, int],
    ceiling: float | None = None,
    vertex_colors: np.ndarray | None = None,
) -> np.ndarray:
    """A shaded picture of a mesh on white.

    Args:
        mesh: metres, faces towards free space; may be empty.
        K: [3, 3] pixels.
        world_T_cam: [4, 4].
        size: (width, height), pixels.
        ceiling: everything above this height (m) is cut off; None cuts nothing.
        vertex_colors: uint8 [V, 3]; clay without them.

    Returns:
        uint8 [height, width, 3].
    """
    hits = cast(mesh, K, world_T_cam, size, ceiling)
    if vertex_colors is None:
        return shade(hits, np.array(CLAY))
    corners = np.asarray(mesh.vertices)[hits.triangles]
    weights = trimesh.triangles.points_to_barycentric(corners, hits.points)
    return shade(hits, np.einsum("nk,nkc->nc", weights, vertex_colors[hits.triangles] / 255))


def cast(
    mesh: trimesh.Trimesh,
    K: np.ndarray,
    world_T_cam: np.ndarray,
    size: tuple[int, int],
    ceiling: float | None = None,
) -> Hits:
    """First hits of the rays through a picture, `FINE`^2 a pixel; arguments as `render_mesh`."""
    width, height = size[0] * FINE, size[1] * FINE
    center = world_T_cam[:3, 3]
    keep = np.einsum("ij,ij->i", mesh.face_normals, center - mesh.triangles_center) > 0
    if ceiling is not None:
        keep &= mesh.triangles[:, :, 2].min(1) < ceiling
    shown = trimesh.Trimesh(mesh.vertices, mesh.faces[keep], process=False)
    row, column = np.divmod(np.arange(width * height), width)
    pixel = (np.stack([column, row], axis=1) + 0.5) / FINE - 0.5
    camera = np.column_stack([pixel, np.ones(len(pixel))]) @ np.linalg.inv(K).T
    directions = trimesh.unitize(camera @ world_T_cam[:3, :3].T)
    origins = np.tile(center, (len(directions), 1))
    if ceiling is not None and center[2] > ceiling:  # rays start on the cut: it is exact
        steepness = np.minimum(directions[:, 2], -1e-6)
        origins += directions * ((ceiling - center[2]) / steepness)[:, None]
    face = _first_hit(shown, origins, directions)
    hit = face >= 0
    face, origins, directions = face[hit], origins[hit], directions[hit]
    normals, anchors = shown.face_normals[face], shown.triangles[face, 0]
    depth = np.einsum("ij,ij->i", anchors - origins, normals)
    depth /= np.einsum("ij,ij->i", directions, normals)
    points = origins + depth[:, None] * directions
    samples = np.stack([row[hit], column[hit]], axis=1)
    brightness = _brightness(shown, points, normals)
    return Hits((height, width), samples, points, shown.faces[face], brightness)


def _first_hit(mesh: trimesh.Trimesh, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Index of the first face on each ray, -1 for none: int [N]."""
    if len(mesh.faces) == 0:
        return np.full(len(origins), -1)
    return np.asarray(mesh.ray.intersects_first(origins, directions))


def _brightness(mesh: trimesh.Trimesh, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Light on surface points [N, 3] with unit normals [N, 3]: [N]."""
    key = np.clip(normals @ trimesh.unitize(LIGHT), 0, 1)
    sky = 0.5 + 0.5 * normals[:, 2]
    return 0.38 * key + (0.42 + 0.32 * sky) * _openness(mesh, points, normals)


def _openness(mesh: trimesh.Trimesh, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Ambient light: 1 where rays from a point meet nothing nearby, 0.25 where all do: [N]."""
    rng = np.random.default_rng(0)
    start = points + 5e-3 * normals
    blocked = np.zeros(len(points))
    for _ in range(AMBIENT_RAYS if len(points) else 0):
        # a normal plus a random unit vector is cosine-distributed about the normal
        direction = trimesh.unitize(normals + trimesh.unitize(rng.normal(size=normals.shape)))
        face = _first_hit(mesh, start, direction)
        across = np.einsum("ij,ij->i", direction, mesh.face_normals[face])
        away = np.einsum("ij,ij->i", mesh.triangles[face, 0] - start, mesh.face_normals[face])
        blocked += (face >= 0) & (np.abs(away) < AMBIENT_REACH * np.abs(across))
    return 1 - 0.75 * blocked / AMBIENT_RAYS


def shade(hits: Hits, color: np.ndarray) -> np.ndarray:
    """The picture of the hits in a colour [3] or colours [N, 3] in [0, 1]: uint8 [h, w, 3]."""
    image = np.ones((*hits.shape, 3))
    colors = np.broadcast_to(color, hits.points.shape) * hits.brightness[:, None]
    image[hits.samples[:, 0], hits.samples[:, 1]] = np.clip(colors, 0, 1)
    height, width = hits.shape
    image = image.reshape(height // FINE, FINE, width // FINE, FINE, 3).mean((1, 3))
    return np.round(255 * image).astype(np.uint8)


def compare(
    prediction: trimesh.Trimesh,
    groundtruth: trimesh.Trimesh | None,
    frames: Sequence[np.ndarray],
    path: Path,
    title: str,
    fscore: float | None = None,
    size: tuple[int, int] = (640, 480),
) -> None:
    """Draw input frames above the prediction, the ground truth and the error, as one PNG.

    All panels share the camera. The error is the distance of each visible point of the prediction
    to the ground-truth surface, whether or not the surface was ever observed there.

    Args:
        prediction: mesh in metres; may be empty.
        groundtruth: mesh in metres; without it only the prediction is drawn.
        frames: uint8 [h, w, 3] images of one size; up to six, evenly chosen, are shown.
        path: the PNG to write.
        title: heading, for instance the scene's name.
        fscore: added to the heading if given.
        size: (width, height) of a panel, pixels.
    """
    reference = prediction if groundtruth is None else groundtruth
    if len(reference.faces) == 0:
        raise TFLabError(f"{path}: there is no surface to draw; the mesh is empty")
    K, world_T_cam, ceiling = overview_camera(reference.bounds, size)
    seen = cast(prediction, K, world_T_cam, size, ceiling)
    label = "Prediction" if len(prediction.faces) else "Prediction (empty)"
    panels = [(label, shade(seen, np.array(CLAY)))]
    if groundtruth is not None:
        surface, _ = trimesh.sample.sample_surface(groundtruth, 200_000, seed=0)
        error = distances(seen.points, np.asarray(surface))
        colors = matplotlib.colormaps[ERROR_COLORS](error / ERROR_SCALE)[:, :3]
        panels.append(("Ground truth", render_mesh(groundtruth, K, world_T_cam, size, ceiling)))
        panels.append(("Distance to ground truth", shade(seen, colors)))
    heading = title if fscore is None else f"{title}    F-score {fscore:.3f}"
    _write(_compare_figure(frames, panels, heading), path)


def _compare_figure(
    frames: Sequence[np.ndarray], panels: list[tuple[str, np.ndarray]], heading: str
) -> Figure:
    count = min(len(frames), 6)
    chosen = [frames[int(i)] for i in np.linspace(0, len(frames) - 1, count).round()]
    width = 4.2 * len(panels)
    strip = width / 6 * chosen[0].shape[0] / chosen[0].shape[1] if chosen else 0.01
    panel = 4.2 * panels[0][1].shape[0] / panels[0][1].shape[1]
    figure = Figure(figsize=(width, 0.9 + strip + panel), dpi=DPI, layout="constrained")
    figure.suptitle(heading, fontsize=13, fontweight="bold")
    parts = figure.subfigures(2, 1, squeeze=False, height_ratios=[strip + 0.1, panel + 0.35])
    top, bottom = parts[:, 0]
    for axes, image in zip(np.ravel(top.subplots(1, 6)), [*chosen, *[None] * 6], strict=False):
        axes.set_axis_off()
        if image is not None:
            axes.imshow(image)
    row = np.ravel(bottom.subplots(1, len(panels)))
    for axes, (label, image) in zip(row, panels, strict=True):
        axes.imshow(image)
        axes.set_title(label, fontsize=11)
        axes.set_axis_off()
    if len(panels) > 1:
        scale = ScalarMappable(Normalize(0, 100 * ERROR_SCALE), ERROR_COLORS)
        bar = bottom.colorbar(
            scale, ax=row[-1], shrink=0.6, aspect=25, extend="max", ticks=[0, 5, 10, 15]
        )
        bar.set_label("cm")
    return figure


LOSSES = {
    "train/loss": ("total", "#222222"),
    "train/coarse": ("coarse mask", "#1b9e77"),
    "train/fine": ("fine mask", "#d95f02"),
    "train/occupancy": ("occupancy", "#7570b3"),
}


def loss_curve(csv_paths: Sequence[Path], path: Path) -> None:
    """Draw the losses, and val/fscore where it was logged, of Lightning's metrics.csv as a PNG.

    Several files are one run that was interrupted; their steps follow each other.

    Columns that are absent and cells that are blank are passed over.

    Raises:
        TFLabError: the file cannot be read or has none of the known columns.
    """
    rows: list[dict[str, str]] = []
    for csv_path in csv_paths:
        try:
            with csv_path.open(newline="") as file:
                rows += csv.DictReader(file)
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise TFLabError(f"{csv_path}: cannot be read as CSV ({error})") from error
    losses = {key: _series(rows, key) for key in LOSSES}
    losses = {key: series for key, series in losses.items() if len(series)}
    score = _series(rows, "val/fscore")
    if not losses and not len(score):
        names = ", ".join(str(p) for p in csv_paths)
        raise TFLabError(f"{names}: none of {', '.join(LOSSES)}, val/fscore was logged")
    count = bool(losses) + bool(len(score))
    figure = Figure(figsize=(5.5 * count, 3.6), dpi=DPI, layout="constrained")
    axes = list(np.ravel(figure.subplots(1, count)))
    if losses:
        _draw_losses(axes[0], losses)
    if len(score):
        axes[-1].plot(score[:, 0], score[:, 1], "o-", color="#1f78b4", markersize=3)
        axes[-1].set(xlabel="step", ylabel="F-score (validation)", ylim=(0, None))
    for ax in axes:
        ax.grid(alpha=0.25)
        ax.spines[["top", "right"]].set_visible(False)
    _write(figure, path)


def _series(rows: list[dict[str, str]], key: str) -> np.ndarray:
    """The finite (step, value) pairs of a column, by step: [N, 2]."""
    pairs = []
    for row in rows:
        try:
            pair = (float(row["step"]), float(row[key]))
        except (KeyError, TypeError, ValueError):  # another metric's row, or one cut short
            continue
        if all(map(math.isfinite, pair)):
            pairs.append(pair)
    return np.array(sorted(pairs)).reshape(-1, 2)


def _draw_losses(axes: Axes, losses: dict[str, np.ndarray]) -> None:
    """Thin raw lines, and bold running means over a fortieth of the curve on each side."""
    for key, series in losses.items():
        label, color = LOSSES[key]
        half = len(series) // 40
        total = np.concatenate([[0.0], np.cumsum(series[:, 1])])
        index = np.arange(len(series))
        first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, len(series))
        mean = (total[last] - total[first]) / (last - first)
        axes.plot(series[:, 0], series[:, 1], color=color, alpha=0.2, linewidth=0.7)
        axes.plot(series[:, 0], mean, color=color, linewidth=1.8, label=label)
    if all((series[:, 1] > 0).all() for series in losses.values()):
        axes.set_yscale("log")
    axes.set(xlabel="step", ylabel="loss (training)")
    axes.legend(frameon=False)


def _write(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", facecolor="white")
