"""Views of surface points, counted: by brute force, and in rooms where the answer is known."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from helpers import box_room
from tf_lab.data.groundtruth import MAX_READING
from tf_lab.data.keyframes import select_keyframes
from tf_lab.data.scene import Frame, Scene, write_scene
from tf_lab.data.visibility import measure_visibility, scene_visibility


@pytest.fixture(scope="module")
def mesh(box_scene: Path) -> trimesh.Trimesh:
    return trimesh.load(box_scene / "groundtruth" / "mesh_gt.ply", process=False)  # type: ignore[return-value]


def test_views_by_brute_force(box_scene: Path, mesh: trimesh.Trimesh) -> None:
    """Ray by ray: a frame sees a vertex if the room's analytic depth along its ray is as far."""
    scene, frames = Scene(box_scene), [2, 5, 6, 13]
    part = trimesh.Trimesh(np.asarray(mesh.vertices)[::211], process=False)
    counts = measure_visibility(scene, frames, part.vertices, MAX_READING).seen
    assert counts.shape == (len(part.vertices),)
    K = box_room.intrinsics()
    least, most = np.zeros(len(counts), int), np.zeros(len(counts), int)
    for frame in frames:
        pose = scene.world_T_cam[frame]
        for i, vertex in enumerate(np.asarray(part.vertices)):
            x, y, z = pose[:3, :3].T @ (vertex - pose[:3, 3])
            u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
            if z < 0.05 or not (-0.45 < u < 79.45 and -0.45 < v < 59.45):
                most[i] += z > 0.05 and -0.55 < u < 79.55 and -0.55 < v < 59.55
                continue
            # the depth of a one-pixel image that looks along the vertex' own ray
            ray = np.array([[K[0, 0], 0, -(u - K[0, 2])], [0, K[1, 1], -(v - K[1, 2])], [0, 0, 1]])
            first = float(box_room.depth_image(pose, ray, (1, 1))[0, 0])
            pixel = 1.5 * z / K[0, 0]  # readings are of pixel centres, up to grazing angles
            least[i] += abs(first - z) < 0.05 - pixel
            most[i] += abs(first - z) < 0.05 + 4 * pixel
    assert (least <= counts).mean() > 0.97
    assert (counts <= most).mean() > 0.99
    assert least.max() >= 2
    assert (most == 0).any()


# --- two boxes of 3 x 3 x 2 m side by side, a wall without a door between them at x = 0 -----------

EYES = np.array([[-2.0, 0, 1.0], [2.0, 0, 1.0]])  # one in each, 2 m before the wall
K = box_room.intrinsics()


@pytest.fixture(scope="module")
def two_rooms(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A frame in each room that looks at the wall between, and one that looks away from it."""

    def frames() -> Iterator[Frame]:
        for i, (eye, yaw) in enumerate(zip([*EYES, EYES[0]], (0, np.pi, np.pi), strict=True)):
            pose = box_room.look(eye, yaw, 0.0)
            u, v = np.meshgrid(np.arange(80), np.arange(60))
            camera = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)])
            rays = np.moveaxis(camera, 0, -1) @ pose[:3, :3].T + 1e-12
            shift = np.array([3.0 * (eye[0] > 0), 0, 0])
            room = np.array([[-3.0, -1.5, 0], [0, 1.5, 2]]) + shift
            depth = np.maximum((room[0] - eye) / rays, (room[1] - eye) / rays).min(-1)
            image = np.zeros((60, 80, 3), np.uint8)
            yield Frame(f"{i}", image, K, pose, depth.astype(np.float32))

    return write_scene(tmp_path_factory.mktemp("scenes") / "two", frames(), {}, "two")


@pytest.mark.parametrize(
    ("point", "candidates", "seen"),
    [
        ((0.0, 0.1, 1.1), 2, 2),  # on the wall between: it has no thickness, both see it
        ((3.0, 0.1, 1.1), 1, 0),  # the second room's end: the first frame points at it
        ((-3.0, 0.1, 1.1), 2, 1),  # the first room's: the second points at it, the third sees it
        ((-2.5, 1.49, 0.3), 1, 0),  # the first room's side: beside the first and the third
    ],
)
def test_a_wall_hides_the_next_room(
    two_rooms: Scene, point: tuple[float, float, float], candidates: int, seen: int
) -> None:
    found = measure_visibility(two_rooms, [0, 1, 2], np.array([point]), reach=5.001)
    assert (found.candidates.tolist(), found.seen.tolist()) == ([candidates], [seen])


def test_share_and_median(two_rooms: Scene) -> None:
    far_ends = np.array([[x, y, 1.0] for x in (-2.99, 2.99) for y in (-0.4, 0.0, 0.4)])
    found = measure_visibility(two_rooms, [0, 1, 2], far_ends)
    # each end is held by the camera of the other room, which does not see it; the third frame
    # holds and sees the first room's
    assert found.candidates.tolist() == [2, 2, 2, 1, 1, 1]
    assert found.seen.tolist() == [1, 1, 1, 0, 0, 0]
    assert found.share == pytest.approx(3 / 9)
    assert found.median == 0.5
    near = measure_visibility(two_rooms, [0, 1, 2], far_ends, reach=4.5)
    assert near.share == 1 and near.candidates.tolist() == [1, 1, 1, 0, 0, 0]


def test_of_a_scene(box_scene: Path) -> None:
    """A convex room with one box: most of what a frustum holds is seen."""
    scene = Scene(box_scene)
    found = scene_visibility(scene, select_keyframes(scene.world_T_cam), points=2000)
    assert 2000 <= len(found.seen) < 4001
    assert (found.seen <= found.candidates).all()
    assert 0.75 < found.share < 1
