"""Which views made a mesh: the map of the best ones, and those kept at points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import trimesh

from tf_lab.errors import TFLabError
from tf_lab.geometry import invert_pose, project
from tf_lab.meshes.raycast import CLAY, Hits, cast, overview_camera, shade
from tf_lab.online.kept import Pick, best_frames, pick
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.reporting.figures.contract import Drawn, Shown, Size
from tf_lab.support.colors import FRAME_COLORS, HIGH, LOW, frame_colors, weight_colors
from tf_lab.support.figures import HEADING, SMALL, TITLE, new_figure
from tf_lab.support.words import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAP: Size = (720, 640)  # pixels
FRUSTUM = 0.22  # metres to a camera's picture
CAMERAS, EXAMPLES = 24, 6  # frames of most surface whose frustums, and whose images, are shown
APART = 0.04  # of the trajectory, between the frames whose images are shown
POINTS, CANDIDATES = 3, 1500
MARGIN = 0.05  # of an image, in which a point is not well shown
ACROSS = 8  # thumbnails in a line


def best_views(shown: Shown) -> Drawn:
    """The mesh in the colours of the frames of greatest weight, with cameras and some frames.

    Raises:
        TFLabError: there is no surface.
    """
    capture, online = shown.capture, shown.result.online
    assert online is not None
    camera = _camera(shown, MAP)
    hits = cast(shown.result.mesh, *camera[:2], MAP, camera[2])
    best = best_frames(online, np.asarray(shown.result.mesh.vertices))
    sources = np.array([*shown.result.keyframes, -1])  # the last: none
    seen = sources[best[_nearest_vertices(shown.result.mesh, hits)]]
    total = len(capture.frames)
    image = shade(hits, frame_colors(seen, total) / 255)
    frames, counts = np.unique(seen[seen >= 0], return_counts=True)
    order = np.argsort(-counts, kind="stable")
    shares = counts / max(len(seen), 1)

    figure = new_figure(12.0, 6.2)
    grid = figure.add_gridspec(3, 4, width_ratios=[6.4, 0.18, 2.4, 2.4])
    axes = figure.add_subplot(grid[:, 0])
    axes.imshow(image)
    _draw_cameras(axes, shown, frames[order[:CAMERAS]], camera)
    axes.set_axis_off()
    axes.set_title(f"{capture.name}: the view of greatest weight", fontsize=HEADING)
    bar = figure.colorbar(_scale(FRAME_COLORS, total - 1), cax=figure.add_subplot(grid[:, 1]))
    bar.set_label("frame along the trajectory")
    for place, i in enumerate(_apart(frames, order, APART * total)[:EXAMPLES]):
        cell = figure.add_subplot(grid[place // 2, 2 + place % 2])
        _framed(cell, capture.image(int(frames[i])), frame_colors(frames[i : i + 1], total)[0])
        cell.set_title(f"frame {frames[i]}: {shares[i]:.0%} of the surface", fontsize=SMALL)
    caption = (
        f"Best views of {capture.name}. The mesh, seen from above without its ceiling, in the "
        "colour of the frame whose attention weight is greatest there (grey: none is kept). "
        f"Frustums: the {min(CAMERAS, len(frames))} of {len(frames)} such frames that are best on "
        f"most of what is seen; right: images of some. "
        f"{len(shown.result.keyframes)} frames were added, K = {online.settings.views}."
    )
    return Drawn(figure, caption)


def selected_views(shown: Shown, points: np.ndarray | None = None) -> Drawn:
    """The views kept at points [P, 3] (metres; None: some of the mesh), by weight.

    Raises:
        TFLabError: there is no surface, or no view is kept at a point.
    """
    capture, online = shown.capture, shown.result.online
    assert online is not None
    size = (400, 300)
    camera = _camera(shown, size)
    hits = cast(shown.result.mesh, *camera[:2], size, camera[2])
    image = shade(hits, np.array(CLAY))
    points = chosen_points(shown, hits) if points is None else points
    picks = [pick(online, shown.result.keyframes, np.asarray(point)) for point in points]
    for found in picks:
        if not found.views:
            raise TFLabError(
                f"{capture.name}: no view is kept at {_place(found)}; choose a point in the room"
            )

    lines = [-(-len(found.views) // ACROSS) for found in picks]
    figure = new_figure(13.0, 0.7 + sum(max(2.4, 1.15 * count + 0.4) for count in lines))
    rows = figure.subfigures(len(picks), 1, squeeze=False, height_ratios=[max(2, n) for n in lines])
    for row, found, count in zip(rows[:, 0], picks, lines, strict=True):
        left, right = row.subfigures(1, 2, width_ratios=[1, 3.1])
        axes = left.subplots()
        axes.imshow(image)
        axes.set_axis_off()
        axes.set_title(f"{_place(found)} m", fontsize=TITLE)
        _draw_rays(axes, shown, found, camera)
        cells = np.ravel(right.subplots(max(count, 2), ACROSS, squeeze=False))
        for cell in cells:
            cell.set_axis_off()
        for cell, view, color in zip(
            cells, found.views, weight_colors(found.weights), strict=False
        ):
            cell.set_axis_on()
            _framed(cell, view.image, color)
            cell.set_title(f"{view.source}: {view.weight:.3f}", fontsize=SMALL)
        text = f"{counted(len(found.views), 'view')} kept, weights {found.weights.sum():.2f} in sum"
        right.suptitle(text, fontsize=TITLE)
        _weight_bar(right, cells, found)
    caption = (
        f"Views kept at {len(picks)} points of {capture.name}, of greatest weight first, as frame: "
        "weight. Frames and rays go from blue (no weight) to red (the point's greatest); a square "
        "marks the point in each view. Weights are those of the first block of the fusion "
        "transformer and sum to 1."
    )
    return Drawn(figure, caption)


def chosen_points(shown: Shown, hits: Hits) -> np.ndarray:
    """Some points [P, 3] (metres) of what is seen, far apart, among those that keep most views."""
    online = shown.result.online
    assert online is not None
    if not len(hits.points):
        raise TFLabError(f"{shown.capture.name}: nothing of the mesh is seen from above")
    some = np.random.default_rng(0).permutation(len(hits.points))[:CANDIDATES]
    points = hits.points[np.sort(some)]
    kept = _showing(online, points)
    points = points[kept == kept.max(initial=0)]
    chosen = [int(np.argmin(np.linalg.norm(points - points.mean(0), axis=1)))]
    for _ in range(1, min(POINTS, len(points))):
        away = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(1)
        chosen.append(int(away.argmax()))
    return np.asarray(points[chosen])


def _showing(online: Reconstructor, points: np.ndarray) -> np.ndarray:
    """How many of the views kept at points [P, 3] show the point itself, not only its voxel."""
    frames, _ = online.view_weights(points)
    pose = online.frames.cameras["world_T_cam"].cpu().numpy()[frames]
    K = online.frames.cameras["K"].cpu().numpy()[frames]
    local = np.einsum("pkji,pkj->pki", pose[..., :3, :3], points[:, None] - pose[..., :3, 3])
    image = np.einsum("pkij,pkj->pki", K, local)
    uv = image[..., :2] / np.maximum(image[..., 2:], 1e-6)
    margin = np.array(online.frames.size) * MARGIN
    inside = ((uv > margin) & (uv < np.array(online.frames.size) - margin)).all(-1)
    return np.asarray((inside & (frames >= 0)).sum(1))


def _apart(frames: np.ndarray, order: np.ndarray, gap: float) -> list[int]:
    """Indices in order, without those of frames nearer than a gap to one before."""
    chosen: list[int] = []
    for i in order:
        if all(abs(int(frames[i]) - int(frames[other])) >= gap for other in chosen):
            chosen.append(int(i))
    return chosen


def _camera(shown: Shown, size: Size) -> tuple[np.ndarray, np.ndarray, float]:
    mesh = shown.truth if shown.truth is not None else shown.result.mesh
    if not len(shown.result.mesh.faces):
        raise TFLabError(f"{shown.capture.name}: the mesh is empty")
    return overview_camera(mesh.bounds, size)


def _nearest_vertices(mesh: trimesh.Trimesh, hits: Hits) -> np.ndarray:
    """The vertex nearest to each hit: what is told of it is not mixed with its neighbours'."""
    corners = np.asarray(mesh.vertices)[hits.triangles]
    nearest = np.linalg.norm(corners - hits.points[:, None], axis=2).argmin(1)
    return np.take_along_axis(hits.triangles, nearest[:, None], 1)[:, 0]


def _pixels(points: np.ndarray, camera: tuple[np.ndarray, np.ndarray, float]) -> np.ndarray:
    """Where points [..., 3] are in a picture: [..., 2]."""
    K, pose = (torch.as_tensor(x).double() for x in camera[:2])
    flat = torch.as_tensor(np.asarray(points).reshape(-1, 3)).double()
    uv, _ = project(flat, K, invert_pose(pose))
    return uv.numpy().reshape(*np.shape(points)[:-1], 2)


def _frustum(shown: Shown, frame: int) -> np.ndarray:
    """Lines [3, 5, 3] (metres) that draw each edge of a frustum."""
    capture = shown.capture
    width, height = capture.size
    pose, K = capture.world_T_cam[frame], capture.K[frame]
    pixels = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
    rays = np.column_stack([pixels, np.ones(4)]) @ np.linalg.inv(K).T
    a, b, c, d = FRUSTUM * rays @ pose[:3, :3].T + pose[:3, 3]
    e = pose[:3, 3]
    return np.array([[e, a, b, c, e], [e, d, a, b, e], [e, c, d, a, e]])


def _draw_cameras(axes: Axes, shown: Shown, frames: np.ndarray, camera: Any) -> None:
    """Frustums in the frames' colours, with a dark edge."""
    path = shown.capture.world_T_cam[shown.result.keyframes][:, :3, 3]
    axes.plot(*_pixels(path, camera).T, color="0.25", linewidth=0.8, alpha=0.7)
    colors = frame_colors(frames, len(shown.capture.frames)) / 255
    for frame, color in zip(frames, colors, strict=True):
        _lines(axes, _pixels(_frustum(shown, int(frame)), camera), color, 1.6)


def _draw_rays(axes: Axes, shown: Shown, found: Pick, camera: Any) -> None:
    """A point, and rays and frustums of the views kept there, the greatest on top."""
    place = _pixels(found.point[None], camera)[0]
    pairs = zip(found.views, weight_colors(found.weights) / 255, strict=True)
    for view, color in reversed([*pairs]):
        center = _pixels(shown.capture.world_T_cam[view.source][:3, 3][None], camera)[0]
        axes.plot(*np.transpose([center, place]), color=color, linewidth=0.9, alpha=0.8)
        _lines(axes, _pixels(_frustum(shown, view.source), camera), color, 1.0)
    axes.plot(*place, "o", color="#FFDC00", markeredgecolor="black", markersize=7, zorder=5)


def _lines(axes: Axes, lines: np.ndarray, color: np.ndarray, width: float) -> None:
    for thick, shade_ in ((width + 1.2, (0.1, 0.1, 0.1)), (width, color)):
        for line in lines:
            axes.plot(*line.T, color=shade_, linewidth=thick, solid_joinstyle="round")


def _framed(axes: Axes, image: np.ndarray, color: np.ndarray) -> None:
    """An image in a frame of a colour."""
    axes.imshow(image)
    axes.set(xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(color=color / 255, linewidth=4)


def _weight_bar(figure: Any, axes: Any, found: Pick) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    colors = LinearSegmentedColormap.from_list("weights", [LOW / 255, HIGH / 255])
    scale = _scale(colors, float(found.weights.max()))
    figure.colorbar(scale, ax=[*axes], shrink=0.8, aspect=15, pad=0.01).set_label("weight")


def _scale(colors: Any, high: float) -> Any:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(0, high), colors)


def _place(found: Pick) -> str:
    return "({:.2f}, {:.2f}, {:.2f})".format(*(np.round(found.point, 2) + 0.0))  # no "-0.00"
