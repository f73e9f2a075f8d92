"""What is drawn: mesh, ground truth, cameras, trajectory, near-surface voxels, the picked point."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from tf_lab.data.capture import Capture
from tf_lab.geometry import COARSE
from tf_lab.meshes.glb import glb_of
from tf_lab.meshes.raycast import CLAY, overview_camera
from tf_lab.online.kept import Pick
from tf_lab.online.surface import Chunk
from tf_lab.support.colors import frame_colors, weight_colors

if TYPE_CHECKING:
    import viser

FRUSTUM, PICKED = 0.08, 0.16  # metres to a camera's picture, and to that of a kept view
NEAR = (0, 114, 178)


class Drawing:
    """The nodes of a scene of viser; a reconstruction's are under one name, to stand beside others.

    Args:
        server: of viser.
        name: begins the nodes' names.
        shift: [3] metres, where it stands.
    """

    def __init__(self, server: viser.ViserServer, name: str, shift: np.ndarray) -> None:
        self.server, self.name = server, name
        self.root = server.scene.add_frame(name, show_axes=False, position=shift)
        self.shift = np.asarray(self.root.position, float)
        self._pieces: dict[Chunk, Any] = {}
        self._cameras: dict[int, Any] = {}
        self._centers: list[np.ndarray] = []
        self._picked: list[Any] = []
        self._near = np.empty((0, 3))
        self._hidden: set[str] = set()

    def clear(self) -> None:
        """Take away all that a reconstruction has made."""
        for node in (*self._pieces.values(), *self._cameras.values(), *self._picked):
            node.remove()
        self._pieces, self._cameras, self._picked, self._centers = {}, {}, [], []
        self.draw_path()

    def draw_piece(self, chunk: Chunk, piece: trimesh.Trimesh | None, colors: np.ndarray) -> None:
        """Draw a chunk's surface in colours (uint8 [V, 3]); None takes it away."""
        old = self._pieces.pop(chunk, None)
        if piece is None:
            if old is not None:
                old.remove()
            return
        shown = trimesh.Trimesh(piece.vertices, piece.faces, vertex_colors=colors, process=False)
        name = f"{self.name}/mesh/{'_'.join(map(str, chunk))}"
        self._pieces[chunk] = self.server.scene.add_glb(
            name, glb_of(shown, np.eye(4)), visible="mesh" not in self._hidden
        )

    def draw_truth(self, mesh: trimesh.Trimesh) -> None:
        """Draw the ground truth."""
        color = np.round(255 * np.array(CLAY)).astype(np.uint8)
        self.server.scene.add_mesh_simple(
            f"{self.name}/truth", mesh.vertices, mesh.faces, color=color
        )

    def draw_camera(self, capture: Capture, frame: int, image: np.ndarray) -> None:
        """Draw a frame's frustum with its image, and the trajectory to it."""
        camera = self._frustum(
            f"cameras/{frame:05d}",
            capture,
            frame,
            image.shape,
            scale=FRUSTUM,
            thickness=0.003,
            color=frame_colors(np.array([frame]), len(capture.frames))[0],
            image=image,
            visible="cameras" not in self._hidden,
        )
        center = capture.world_T_cam[frame, :3, 3]

        @camera.on_click
        def _(event: viser.SceneNodePointerEvent[Any]) -> None:
            """Look through this camera."""
            event.client.camera.wxyz = camera.wxyz
            event.client.camera.position = center + self.shift

        self._cameras[frame] = camera
        self._centers.append(center)
        self.draw_path()

    def draw_path(self) -> None:
        """The trajectory as far as it goes."""
        points = np.array(self._centers).reshape(-1, 3)
        lines = np.stack([points[:-1], points[1:]], 1) if len(points) > 1 else np.zeros((1, 2, 3))
        shown = "path" not in self._hidden and len(points) > 1
        self.server.scene.add_line_segments(
            f"{self.name}/path", lines, (60, 60, 60), thickness=0.006, visible=shown
        )

    def draw_near(self, centers: np.ndarray, voxel: float) -> None:
        """Near-surface voxels as points [N, 3] (metres)."""
        if np.array_equal(centers, self._near):
            return
        self._near = centers
        size = 0.05 if voxel == COARSE else 0.02
        self.server.scene.add_point_cloud(
            f"{self.name}/near", centers, NEAR, point_size=size, visible=len(centers) > 0
        )

    def draw_pick(self, pick: Pick, capture: Capture) -> None:
        """The picked point, and rays to the cameras kept there by the colour of their weight."""
        for node in self._picked:
            node.remove()
        add, colors = self.server.scene, weight_colors(pick.weights)
        self._picked = [
            add.add_icosphere(
                f"{self.name}/picked/point", 0.03, color=(255, 220, 0), position=pick.point
            )
        ]
        for view, color in zip(pick.views, colors, strict=True):
            frustum = self._frustum(
                f"picked/{view.source:05d}",
                capture,
                view.source,
                view.image.shape,
                scale=PICKED,
                thickness=0.008,
                color=color,
            )
            ray = add.add_line_segments(
                f"{self.name}/picked/ray_{view.source:05d}",
                np.stack([capture.world_T_cam[view.source, :3, 3], pick.point])[None],
                color,
                thickness=0.004,
            )
            self._picked += [frustum, ray]

    def _frustum(
        self, name: str, capture: Capture, frame: int, shape: tuple[int, ...], **style: Any
    ) -> viser.CameraFrustumHandle:
        """The frustum of a frame, whose image has this shape."""
        pose, K = capture.world_T_cam[frame], capture.K[frame]
        height, width = shape[:2]
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        return self.server.scene.add_camera_frustum(
            f"{self.name}/{name}",
            fov=2 * math.atan(height / 2 / K[1, 1]),
            aspect=width / height,
            wxyz=(w, x, y, z),
            position=pose[:3, 3],
            **style,
        )

    def set_visible(self, what: str, visible: bool) -> None:
        """Show or hide "mesh", "cameras", "path" or "truth"."""
        self._hidden.discard(what) if visible else self._hidden.add(what)
        one = self.server.scene.get_handle_by_name(f"{self.name}/{what}")
        nodes = {"mesh": self._pieces.values(), "cameras": self._cameras.values()}
        for node in list(nodes.get(what, [one] if one is not None else [])):  # pieces may come
            node.visible = visible


def look_from_above(server: viser.ViserServer, bounds: np.ndarray) -> None:
    """Where pages begin to look from: a bird's-eye view of a box [2, 3] (metres)."""
    _, pose, _ = overview_camera(bounds)
    center = bounds.mean(0)
    away = 0.7 * np.linalg.norm(bounds[1] - bounds[0])
    camera = server.initial_camera
    camera.up = (0.0, 0.0, 1.0)
    camera.look_at = center
    camera.position = center - away * pose[:3, 2]
