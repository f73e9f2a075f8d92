"""Ground truth of the analytic box room against its known distances."""

import errno
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree
from torch import Tensor

from helpers import box_room
from tf_lab.data.chunk_weights import EMPTY_SHARE, Structure, chunk_candidates
from tf_lab.data.groundtruth import (
    MAX_DISTANCE,
    GroundTruth,
    GroundTruthSettings,
    fuse_capture,
    signed_distance,
    surface_distance,
    write_groundtruth,
)
from tf_lab.data.scene import Frame, write_scene
from tf_lab.data.tsdf import TSDF
from tf_lab.errors import TFLabError
from tf_lab.geometry import COARSE, FINE, VoxelGrid

VOXEL = GroundTruthSettings().voxel
TRUNCATION = GroundTruthSettings().truncation


@pytest.fixture(scope="module")
def truth(box_scene: Path) -> GroundTruth:
    return GroundTruth(box_scene / "groundtruth")


@pytest.fixture(scope="module")
def files(box_scene: Path) -> Path:
    return box_scene / "groundtruth"


@pytest.fixture(scope="module")
def mesh(files: Path) -> trimesh.Trimesh:
    return trimesh.load(files / "mesh_gt.ply", process=False)  # type: ignore[return-value]


def points_in(lower: np.ndarray, upper: np.ndarray, count: int = 4000) -> np.ndarray:
    return np.random.default_rng(0).uniform(lower, upper, (count, 3))


def tensor(points: np.ndarray) -> Tensor:
    return torch.from_numpy(points).float()


def test_the_mesh_lies_on_the_walls_and_the_box(mesh: trimesh.Trimesh) -> None:
    off = np.abs(box_room.signed_distance(np.asarray(mesh.vertices)))
    assert off.mean() < 0.006
    room = np.ptp(box_room.ROOM, axis=0)
    area = 2 * (room[0] * room[1] + room[1] * room[2] + room[2] * room[0]) + 4 * 0.36
    assert mesh.area == pytest.approx(area, rel=0.03)
    into_room = box_room.signed_distance(mesh.triangles_center + 0.05 * mesh.face_normals)
    assert (into_room > 0).mean() > 0.99


def test_world2grid_maps_voxel_centres_to_integers(files: Path, truth: GroundTruth) -> None:
    world2grid = np.loadtxt(files / "world2grid.txt")
    mask = np.load(files / "occlusion_mask.npy")
    assert mask.dtype == np.uint8
    assert mask.shape == truth.grid.shape
    centers = truth.grid.centers().double().numpy().reshape(-1, 3)
    index = centers @ world2grid[:3, :3].T + world2grid[:3, 3]
    np.testing.assert_allclose(index, np.argwhere(np.ones(mask.shape)), atol=1e-4)
    assert truth.grid.voxel == pytest.approx(VOXEL)


def test_the_occlusion_mask_marks_what_no_frame_observed(files: Path, truth: GroundTruth) -> None:
    occluded = np.load(files / "occlusion_mask.npy").astype(bool)
    distance = box_room.signed_distance(truth.grid.centers().numpy().reshape(-1, 3))
    distance = distance.reshape(occluded.shape)
    # The truncation is along the optical axis; across a slanting ray it reaches up to 1.5 times
    # as far. This is behind the walls and inside the box.
    assert occluded[distance < -1.5 * TRUNCATION].all()
    assert occluded[distance > VOXEL].mean() < 0.01  # 20 cameras see all but all of the room
    assert occluded[np.abs(distance) < 0.02].mean() < 0.01
    inside = truth.grid.to_index(torch.tensor([[0.63, -0.01, 0.32]])).round().long()[0].tolist()
    assert occluded[tuple(inside)]


def test_signed_distance_near_the_surface(truth: GroundTruth) -> None:
    points = points_in(box_room.ROOM[0], box_room.ROOM[1], 20_000)
    true = box_room.signed_distance(points)
    near = points[np.abs(true) < 0.06]
    found = truth.signed_distance(tensor(near)).numpy()
    assert np.isfinite(found).mean() > 0.95  # not where an edge hides one of the 8 voxels around
    error = np.abs(found - box_room.signed_distance(near))
    assert np.nanmedian(error) < 0.008
    assert np.nanmean(error) < 0.012
    free = points[true > 0.3]
    found = truth.signed_distance(tensor(free)).numpy()
    np.testing.assert_allclose(found, TRUNCATION, atol=1e-3)  # clipped there


def test_behind_the_box_is_unknown_and_behind_the_walls_is_solid(
    truth: GroundTruth, files: Path
) -> None:
    inside = points_in(box_room.BOX[0] + 0.2, box_room.BOX[1] - 0.2, 50)
    assert torch.isnan(truth.signed_distance(tensor(inside))).all()
    # under the floor and above the ceiling of columns that were seen
    middle = tensor(np.array([[0.0, 0, box_room.ROOM[0][2] - 0.13], [0, 0, 2.02 + 0.155]]))
    assert torch.isnan(truth.signed_distance(middle)).all()
    # at the corners of the grid whole columns lie behind two walls
    lower = np.array(truth.grid.origin) + 0.01
    for x in (lower[0], box_room.ROOM[1][0] + 0.16):
        for y in (lower[1], box_room.ROOM[1][1] + 0.16):
            column = tensor(np.array([[x, y, z] for z in np.arange(lower[2], 2.1, 0.05)]))
            assert (truth.signed_distance(column) + TRUNCATION).abs().max() < 1e-3
    occluded = np.load(files / "occlusion_mask.npy").astype(bool)
    columns = np.broadcast_to(occluded.all(2, keepdims=True), occluded.shape)
    sdf = np.load(files / "sdf.npy")
    assert np.array_equal(np.isnan(sdf), occluded & ~columns)
    np.testing.assert_allclose(sdf[columns], -TRUNCATION, atol=1e-3)
    assert np.abs(sdf[~occluded]).max() < TRUNCATION + 1e-3


def test_column_rule_by_hand() -> None:
    """Four columns: free then surface then hidden; all hidden; hidden at both ends; all seen."""
    seen = torch.tensor([[0, 0, 1, 1], [0, 0, 0, 0], [0, 1, 1, 0], [1, 1, 1, 1]]).bool()
    distance = torch.linspace(-0.1, 0.1, 16).view(4, 1, 4)
    tsdf = TSDF(
        VoxelGrid((0, 0, 0), 0.1, (4, 1, 4)), distance, seen[:, None].float(), truncation=0.12
    )
    found = signed_distance(tsdf)[:, 0]
    assert torch.equal(torch.isnan(found), ~seen & seen.any(1, keepdim=True))
    assert torch.equal(found[seen], distance[:, 0][seen])
    torch.testing.assert_close(found[1], torch.full((4,), -0.12))


def test_surface_distance(truth: GroundTruth) -> None:
    points = points_in(box_room.ROOM[0] - 0.1, box_room.ROOM[1] + 0.1)
    true = np.minimum(np.abs(box_room.signed_distance(points)), MAX_DISTANCE)
    found = truth.surface_distance(tensor(points)).numpy()
    known = box_room.signed_distance(points) > -0.05  # there is no floor under the box
    error = (found - true)[known]
    # to the nearest vertex rather than to the surface between them: too large close to it
    assert np.quantile(np.abs(error), 0.95) < 0.025
    far = known & (true > 0.09)
    assert np.abs((found - true)[far]).mean() < 0.006


def test_near_masks_by_brute_force(truth: GroundTruth, mesh: trimesh.Trimesh) -> None:
    """As a chunk asks: voxel centres within v_c, v_f of the surface."""
    rng = np.random.default_rng(1)
    samples = mesh.triangles[rng.integers(0, len(mesh.faces), 40_000)]
    samples = (rng.dirichlet(np.ones(3), 40_000)[..., None] * samples).sum(1)
    for radius in (FINE, COARSE):
        centers = points_in(box_room.ROOM[0], box_room.ROOM[1], 300)
        distance = np.array([np.linalg.norm(samples - c, axis=1).min() for c in centers])
        near = truth.surface_distance(tensor(centers)).numpy() < radius
        clear = np.abs(distance - radius) > 0.02
        assert clear.mean() > 0.8
        assert (near == (distance < radius))[clear].all()
        assert 0.1 < near.mean() < 0.95


def test_surface_distance_of_known_vertices() -> None:
    grid = VoxelGrid((0, 0, 0), 0.1, (3, 4, 12))
    vertices = [[0.05, 0.05, 0.05], [0.25, 0.05, 0.05], [0.05, 0.35, 0.05]]
    found = surface_distance(cKDTree(vertices), grid)
    assert found[0, 0, 0].item() == pytest.approx(0, abs=1e-6)
    assert found[0, 0, 3].item() == pytest.approx(0.3, abs=1e-6)
    assert found[1, 1, 0].item() == pytest.approx(0.02**0.5, abs=1e-6)
    assert found[0, 0, 11] == MAX_DISTANCE


@pytest.mark.parametrize("beyond", [0.005, 0.3])
def test_outside_of_the_volume_nothing_is_known(truth: GroundTruth, beyond: float) -> None:
    lower = torch.tensor(truth.grid.origin)
    upper = lower + VOXEL * torch.tensor(truth.grid.shape)
    outside = torch.stack([lower - beyond, upper + beyond, lower - 100])
    for points in (outside, torch.cat([outside, torch.zeros(1, 3)])):
        assert torch.isnan(truth.signed_distance(points)[:3]).all()
        assert (truth.surface_distance(points)[:3] == MAX_DISTANCE).all()


def test_points_in_the_outermost_half_voxel_are_inside(truth: GroundTruth) -> None:
    """One alone or among others, a point gets the same answer."""
    upper = torch.tensor(truth.grid.origin) + VOXEL * torch.tensor(truth.grid.shape)
    corners = torch.stack([torch.tensor(truth.grid.origin) + 0.01, upper - 0.01])
    together = truth.signed_distance(corners)
    torch.testing.assert_close(together, torch.full((2,), -TRUNCATION), atol=1e-3, rtol=0)
    alone = torch.cat([truth.signed_distance(c[None]) for c in corners])
    torch.testing.assert_close(alone, together)


def parts(*boxes: tuple[list[float], list[float]]) -> trimesh.Trimesh:
    """A vertex every 4 cm on the faces of boxes."""
    vertices = []
    for lower, upper in boxes:
        axes = [np.arange(a, b + 0.02, 0.04) for a, b in zip(lower, upper, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        lowest, highest = grid.min(0), grid.max(0)
        vertices.append(grid[((grid == lowest) | (grid == highest)).any(1)])
    return trimesh.Trimesh(np.concatenate(vertices), process=False)


def test_chunk_weights_rise_from_free_space_over_walls_to_furniture() -> None:
    """An 8 x 8 x 2.6 m hall with furniture in one corner."""
    hall = parts(([0, 0, 0], [8, 8, 2.6]), ([1, 1, 0.6], [1.8, 1.8, 1.4]))
    centers, weight = chunk_candidates(hall, VoxelGrid((0, 0, 0), VOXEL, (200, 200, 65)))
    assert centers.dtype == weight.dtype == np.float32

    def at(*point: float) -> float:
        return float(weight[np.linalg.norm(centers - np.array(point), axis=1).argmin()])

    # 1.5 m chunks: the air at half height sees neither floor nor ceiling
    assert at(5.1, 5.1, 1.2) == pytest.approx(0.15)
    assert at(7.8, 5.1, 1.2) == pytest.approx(1.0)  # a wall
    assert at(5.1, 5.1, 0.0) == pytest.approx(1.0)  # the floor
    assert at(1.4, 1.4, 1.0) > 2
    assert 0.15 <= weight.min() <= weight.max() <= 3


@pytest.mark.parametrize("flipped", [False, True])
def test_labels_say_what_is_furniture(flipped: bool) -> None:
    """Whatever its shape: here the box, or all but the box."""
    hall = parts(([0, 0, 0], [8, 8, 2.6]), ([1, 1, 0.6], [1.8, 1.8, 1.4]))
    points = np.asarray(hall.vertices)
    box = ((points > [0.99, 0.99, 0.59]) & (points < [1.81, 1.81, 1.41])).all(1)
    grid = VoxelGrid((0, 0, 0), VOXEL, (200, 200, 65))
    centers, weight = chunk_candidates(hall, grid, structure=Structure(points, ~box ^ flipped))
    at_box, at_wall = (
        weight[np.linalg.norm(centers - np.array(place), axis=1).argmin()]
        for place in ((1.4, 1.4, 1.0), (7.8, 5.1, 1.2))
    )
    assert (at_box > 2, at_wall > 2) == (not flipped, flipped)


def test_a_scene_of_walls_alone_has_no_furniture() -> None:
    _, weight = chunk_candidates(
        parts(([0, 0, 0], [4, 4, 2.4])), VoxelGrid((0, 0, 0), VOXEL, (100, 100, 60))
    )
    empty = weight < 1
    assert (weight[~empty] == 1).all()
    assert weight[empty].sum() == pytest.approx(EMPTY_SHARE * weight[~empty].sum(), rel=1e-3)


def test_chunks_of_the_room(truth: GroundTruth) -> None:
    near_box = (np.abs(truth.centers - box_room.BOX.mean(0)).max(1) < 0.5).nonzero()[0]
    far_from_it = (truth.centers[:, 0] < -0.7).nonzero()[0]
    assert truth.weight[near_box].min() > 1.3
    assert truth.weight[near_box].min() > truth.weight[far_from_it].mean()
    # up to a chunk beyond the room there is little to learn but that nothing is there
    beyond = ((truth.centers < box_room.ROOM[0]) | (truth.centers > box_room.ROOM[1])).any(1)
    assert truth.weight[beyond].mean() < 0.5 < truth.weight[~beyond].mean()
    assert np.abs(truth.centers - box_room.ROOM.mean(0)).max() < 1.5 + 1.5 + 0.05


@pytest.mark.filterwarnings("ignore:loadtxt")
@pytest.mark.parametrize("name", ["sdf.npy", "distance.npy", "world2grid.txt", "chunks.npz"])
@pytest.mark.parametrize("damage", ["missing", "truncated", "empty", "other"])
def test_damaged_files(files: Path, tmp_path: Path, name: str, damage: str) -> None:
    copy = tmp_path / "groundtruth"
    shutil.copytree(files, copy)
    path = copy / name
    content = path.read_bytes()
    path.unlink()
    if damage == "other":
        np.save(copy / "other.npy", np.zeros(7))
        path.write_bytes((copy / "other.npy").read_bytes())
    elif damage != "missing":
        path.write_bytes(content[: len(content) // 2] if damage == "truncated" else b"")
    with pytest.raises(TFLabError, match=r"groundtruth: the ground truth is damaged.*prepare it"):
        GroundTruth(copy)


def test_too_many_open_files_are_no_damage(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(np.lib.format, "open_memmap", refused)
    with pytest.raises(TFLabError, match="too many open files; allow more") as caught:
        GroundTruth(files)
    assert "damaged" not in str(caught.value) and "delete" not in str(caught.value)


def test_captures_that_give_no_ground_truth(tmp_path: Path) -> None:
    pose, K = box_room.look(np.zeros(3), 0.0, 0.0), box_room.intrinsics()
    image = np.zeros((60, 80, 3), np.uint8)
    blind = Frame("a", image, K, pose, np.zeros((60, 80), np.float32))
    bare = Frame("a", image, K, pose, None)
    for name, frame, message in (("blind", blind, "no depth reading"), ("bare", bare, "no depth")):
        scene = write_scene(tmp_path / name, [frame], {}, name)
        with pytest.raises(TFLabError, match=message):
            write_groundtruth(scene, scene.groundtruth, GroundTruthSettings())
        assert not scene.groundtruth.exists()


def test_readings_beyond_far_do_not_widen_the_volume(tmp_path: Path) -> None:
    depth = np.full((60, 80), 2.0, np.float32)
    depth[:3] = 9.0
    pose = box_room.look(np.zeros(3), 0.0, 0.0)
    frame = Frame("a", np.zeros((60, 80, 3), np.uint8), box_room.intrinsics(), pose, depth)
    scene = write_scene(tmp_path / "scene", [frame], {}, "scene")
    grid, _ = fuse_capture(scene, GroundTruthSettings())
    assert grid.origin[0] + grid.voxel * grid.shape[0] < 2.4


def test_what_scores_need_is_the_same_without_what_training_needs(tmp_path: Path) -> None:
    pose, K = box_room.look(np.zeros(3), 0.0, 0.0), box_room.intrinsics()
    frame = Frame("a", np.zeros((60, 80, 3), np.uint8), K, pose, np.full((60, 80), 2.0, np.float32))
    scene = write_scene(tmp_path / "scene", [frame], {}, "scene")
    for name, training in (("all", True), ("some", False)):
        write_groundtruth(scene, tmp_path / name, GroundTruthSettings(), training=training)
    some = {path.name for path in (tmp_path / "some").iterdir()}
    assert some == {"mesh_gt.ply", "occlusion_mask.npy", "world2grid.txt"}
    assert some < {path.name for path in (tmp_path / "all").iterdir()}
    for name in some:
        assert (tmp_path / "some" / name).read_bytes() == (tmp_path / "all" / name).read_bytes()


def test_distance_is_to_the_faces_of_a_given_mesh(tmp_path: Path) -> None:
    """Of a wall of two triangles, whose vertices are metres away; the depth sees another wall."""
    pose, K = box_room.look(np.zeros(3), 0.0, 0.0), box_room.intrinsics()
    frame = Frame("a", np.zeros((60, 80, 3), np.uint8), K, pose, np.full((60, 80), 2.0, np.float32))
    scene = write_scene(tmp_path / "scene", [frame], {}, "scene")
    forward = pose[:3, 2]
    across, up = pose[:3, 0], pose[:3, 1]
    centre = 1.9 * forward
    corners = [centre + 4 * (a * across + b * up) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    wall = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    settings = GroundTruthSettings()
    write_groundtruth(scene, tmp_path / "given", settings, mesh=wall)
    truth = GroundTruth(tmp_path / "given")
    centers = truth.grid.centers().reshape(-1, 3).numpy()
    expected = np.minimum(np.abs(centers @ forward - 1.9), 0.4)
    found = np.asarray(truth.distance_volume, np.float32).ravel()
    np.testing.assert_allclose(found, expected, atol=0.011)  # vertices are 2 cm apart at most
    near = expected > 0.08
    np.testing.assert_allclose(found[near], expected[near], atol=0.002)
    assert len(trimesh.load(tmp_path / "given" / "mesh_gt.ply", process=False).vertices) == 4


def test_how_fine_a_given_mesh_is_does_not_move_the_chunks(tmp_path: Path) -> None:
    pose, K = box_room.look(np.zeros(3), 0.0, 0.0), box_room.intrinsics()
    frame = Frame("a", np.zeros((60, 80, 3), np.uint8), K, pose, np.full((60, 80), 2.0, np.float32))
    scene = write_scene(tmp_path / "scene", [frame], {}, "scene")
    write_groundtruth(scene, tmp_path / "own", GroundTruthSettings())
    own = trimesh.load(tmp_path / "own" / "mesh_gt.ply", process=False)
    finer = own.subdivide().subdivide()
    write_groundtruth(scene, tmp_path / "given", GroundTruthSettings(), mesh=finer)
    given = trimesh.load(tmp_path / "given" / "mesh_gt.ply", process=False)
    assert len(given.vertices) == len(finer.vertices)
    chunks = [dict(np.load(tmp_path / name / "chunks.npz")) for name in ("own", "given")]
    for name in ("centers", "weight"):
        np.testing.assert_array_equal(chunks[0][name], chunks[1][name])
