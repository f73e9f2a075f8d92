"""A room from above and from inside."""

from __future__ import annotations

import numpy as np
import torch
import trimesh

from tf_lab.errors import TFLabError
from tf_lab.geometry import scale_intrinsics
from tf_lab.meshes.glb import vertex_colors
from tf_lab.meshes.raycast import overview_camera, render_mesh
from tf_lab.reporting.figures.contract import TRUTH, Drawn, Shown, Size
from tf_lab.support.figures import HEADING, PANEL, TITLE, new_figure

WIDTH = 480  # pixels of a panel, which is as high as the capture's images
INSIDE = (0.25, 0.7)  # of the trajectory: where one looks from inside


def room(shown: Shown, width: int = WIDTH) -> Drawn:
    """The mesh from above, its ceiling cut, and through cameras, beside images and ground truth.

    Raises:
        TFLabError: there is no surface.
    """
    capture, mesh = shown.capture, shown.result.mesh
    if not len(mesh.faces):
        raise TFLabError(f"{capture.name}: the mesh is empty")
    size = (width, round(width * capture.size[1] / capture.size[0]))
    colors = vertex_colors(mesh)
    K, pose, cut = overview_camera((mesh if shown.truth is None else shown.truth).bounds, size)
    rows = {
        "from above": [
            render_mesh(mesh, K, pose, size, cut),
            render_mesh(mesh, K, pose, size, cut, colors),
            _truth(shown.truth, K, pose, size, cut),
        ]
    }
    frames = shown.result.keyframes
    for share in INSIDE:
        frame = frames[int(share * (len(frames) - 1))]
        intrinsics = torch.as_tensor(capture.K[frame])
        K = scale_intrinsics(intrinsics, capture.size, size).numpy()
        pose = capture.world_T_cam[frame]
        rows[f"frame {frame}"] = [
            capture.image(frame),
            render_mesh(mesh, K, pose, size, vertex_colors=colors),
            _truth(shown.truth, K, pose, size),
        ]
    columns = 2 if shown.truth is None else 3
    figure = new_figure(PANEL * columns + 0.3, (PANEL * size[1] / size[0] + 0.25) * 3 + 0.4)
    figure.suptitle(capture.name, fontsize=HEADING, fontweight="bold")
    grid = figure.subplots(3, columns, squeeze=False)
    for line, (name, images) in zip(grid, rows.items(), strict=True):
        for axes, image in zip(line, images, strict=False):
            assert image is not None
            axes.imshow(image, extent=(0, size[0], size[1], 0))
            axes.set(xticks=[], yticks=[], frame_on=False)
        line[0].set_ylabel(name, fontsize=TITLE)
    titles = (
        ("Reconstruction", "In the images' colours", TRUTH),
        ("Image", "Reconstruction", TRUTH),
    )
    for line, names in zip(grid, titles, strict=False):
        for axes, title in zip(line, names, strict=False):
            axes.set_title(title, fontsize=TITLE)
    caption = (
        f"{capture.name}, from above without its ceiling and from inside, through cameras of the "
        "capture; a wall is left out where it is seen from behind."
    )
    return Drawn(figure, caption)


def _truth(
    mesh: trimesh.Trimesh | None,
    K: np.ndarray,
    pose: np.ndarray,
    size: Size,
    cut: float | None = None,
) -> np.ndarray | None:
    return None if mesh is None else render_mesh(mesh, K, pose, size, cut)
