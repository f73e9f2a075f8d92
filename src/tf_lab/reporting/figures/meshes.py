"""The same scene under several methods: side by side, with an inset, and by its errors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import trimesh
from scipy.ndimage import uniform_filter

from tf_lab.errors import TFLabError
from tf_lab.evaluation.pictures import error_bar
from tf_lab.evaluation.truth import Truth
from tf_lab.meshes.raycast import cast, render_mesh, shade
from tf_lab.reporting.figures.contract import TRUTH, Compared, Drawn, Size
from tf_lab.support.colors import ERROR_SCALE, error_colors
from tf_lab.support.figures import HEADING, PANEL, TITLE, new_figure, panel_grid

SIZE: Size = (400, 300)  # pixels of a panel
INSET = 3  # times: an inset shows so much of a panel's width and height
COLUMNS = 5
INK = "#D55E00"  # of an inset's frame


def comparison(scenes: Sequence[Compared], size: Size = SIZE) -> Drawn:
    """Scenes in rows, methods and the ground truth in columns, under each an inset.

    Raises:
        TFLabError: there is nothing to draw.
    """
    methods = [*scenes[0].meshes]
    columns = [*methods, *([TRUTH] if scenes[0].truth is not None else [])]
    ratio = size[1] / size[0]
    figure = new_figure(PANEL * len(columns), (2 * PANEL * ratio + 0.45) * len(scenes))
    parts = figure.subfigures(len(scenes), 1, squeeze=False)[:, 0]
    for part, scene in zip(parts, scenes, strict=True):
        camera, draw = scene.camera(size), partial(_panels, scene, columns)
        whole = draw(*camera, size)
        window = differing(whole, size)
        inset = draw(zoomed(camera[0], window), *camera[1:], size)
        grid = part.subplots(2, len(columns), squeeze=False)
        part.supylabel(scene.scene, fontsize=TITLE)
        for column, method in enumerate(columns):
            above, below = grid[:, column]
            above.imshow(whole[column])
            above.set_title(scene.title(method), fontsize=TITLE)
            above.set_axis_off()
            (x, y), (w, h) = window, (size[0] / INSET, size[1] / INSET)
            above.plot([x, x + w, x + w, x, x], [y, y, y + h, y + h, y], color=INK, linewidth=1.5)
            below.imshow(inset[column])
            below.set(xticks=[], yticks=[])
            for spine in below.spines.values():
                spine.set(color=INK, linewidth=1.5)
    names = ", ".join(scene.scene for scene in scenes)
    caption = (
        f"Reconstructions of {names}, from above without the ceiling; F: F-score at 5 cm. Below "
        f"each the part in the frame, {INSET} times as large: where the columns differ most."
        f"{scenes[0].made_of()}"
    )
    return Drawn(figure, caption)


def ablations(scene: Compared, size: Size = SIZE, heading: str = "") -> Drawn:
    """A scene under every row.

    Raises:
        TFLabError: there is nothing to draw.
    """
    camera = scene.camera(size)
    truth = [] if scene.truth is None else [TRUTH]
    names = [*truth, *scene.meshes]
    images = _panels(scene, names, *camera, size)
    panels = {scene.title(name): image for name, image in zip(names, images, strict=True)}
    caption = (
        f"{scene.scene} under {len(scene.meshes)} variations of one method, from above without the "
        "ceiling; F: F-score at 5 cm."
    )
    return Drawn(panel_grid(panels, heading or scene.scene, COLUMNS), caption)


def errors(scene: Compared, size: Size = SIZE) -> Drawn:
    """What each method's mesh is off, and what it misses, in cm.

    Raises:
        TFLabError: there is no ground truth, or nothing to draw.
    """
    if scene.truth is None:
        raise TFLabError(f"{scene.scene}: without ground truth there are no errors to draw")
    camera, truth = scene.camera(size), Truth(scene.truth)
    methods = {name: mesh for name, mesh in scene.meshes.items() if len(mesh.faces)}
    if not methods:
        raise TFLabError(f"{scene.scene}: there is no error to draw; all meshes are empty")
    figure = new_figure(PANEL * len(methods) + 1.2, 2 * PANEL * size[1] / size[0] + 1.1)
    grid = figure.subplots(2, len(methods), squeeze=False)
    for column, (name, mesh) in enumerate(methods.items()):
        for row, (drawn, to) in enumerate(((mesh, truth), (scene.truth, Truth(mesh)))):
            hits = cast(drawn, *camera[:2], size, camera[2])
            off = to.distances(hits.points)
            axes = grid[row, column]
            axes.imshow(shade(hits, error_colors(off) / 255))
            axes.set(xticks=[], yticks=[], frame_on=False)
            if len(off):
                axes.set_xlabel(f"median {100 * np.median(off):.1f} cm", fontsize=TITLE)
        grid[0, column].set_title(scene.title(name), fontsize=TITLE)
    grid[0, 0].set_ylabel("accuracy: mesh to truth", fontsize=TITLE)
    grid[1, 0].set_ylabel("completeness: truth to mesh", fontsize=TITLE)
    figure.suptitle(f"{scene.scene}: errors", fontsize=HEADING, fontweight="bold")
    error_bar(figure, grid)
    caption = (
        f"Errors in {scene.scene}. Above: each point of the mesh by its distance to the ground "
        "truth (accuracy); below: each point of the ground truth by its distance to the mesh "
        f"(completeness: dark is missing); {100 * ERROR_SCALE:g} cm and more have one colour. "
        f"Medians are over what is seen.{scene.made_of()}"
    )
    return Drawn(figure, caption)


def _panels(
    scene: Compared, names: Sequence[str], K: np.ndarray, pose: np.ndarray, cut: float, size: Size
) -> list[np.ndarray]:
    """Pictures of a scene's meshes by one camera; white of one that is not there."""
    meshes = dict(scene.meshes)
    if scene.truth is not None:
        meshes[TRUTH] = scene.truth
    empty = trimesh.Trimesh()
    return [render_mesh(meshes.get(name, empty), K, pose, size, cut) for name in names]


def differing(panels: Sequence[np.ndarray], size: Size) -> tuple[int, int]:
    """The upper left corner (x, y) of the window in which pictures differ most."""
    spread = np.std([panel.mean(-1) for panel in panels], axis=0)
    width, height = size[0] // INSET, size[1] // INSET
    mean = uniform_filter(spread, (height, width), mode="constant")
    inner = mean[height // 2 : size[1] - height // 2, width // 2 : size[0] - width // 2]
    row, column = np.unravel_index(int(inner.argmax()), inner.shape)
    return int(column), int(row)


def zoomed(K: np.ndarray, corner: tuple[int, int]) -> np.ndarray:
    """Intrinsics [3, 3] of a picture's window, `INSET` times as large; pixels as in `geometry`."""
    scaled = K.copy()
    scaled[:2] *= INSET
    scaled[:2, 2] = (K[:2, 2] - np.array(corner) + 0.5) * INSET - 0.5
    return scaled
