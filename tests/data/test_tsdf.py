"""Depth fusion of analytic planes, balls and rooms."""

import math
import subprocess
import sys

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from helpers import box_room
from helpers.depth_views import (
    DOWN,
    FAR,
    SIZE,
    TRUNCATION,
    K,
    corridor,
    look_from,
    plane_depth,
    rays,
)
from tf_lab.data.tsdf import (
    BYTES,
    TSDF,
    bounds_of,
    extract_mesh,
    fuse,
    fuse_in_slabs,
    join,
    unproject,
)
from tf_lab.errors import TFLabError
from tf_lab.geometry import VoxelGrid


def ball_depth(pose: Tensor, center: Tensor, radius: float) -> Tensor:
    r, offset = rays(pose), pose[:3, 3] - center
    a, b, c = r.square().sum(-1), (r * offset).sum(-1), offset.square().sum() - radius**2
    root = b**2 - a * c
    return torch.where(root > 0, (-b - root.clamp(min=0).sqrt()) / a, 0.0)


def one_view(depth: Tensor, pose: Tensor, grid: VoxelGrid, far: float = FAR) -> TSDF:
    return fuse([depth], K[None], pose[None], grid, TRUNCATION, far)


GRID = VoxelGrid((-0.4, -0.3, -0.4), 0.04, (20, 15, 30))  # to z = 0.8; centres at +-0.02


def test_a_plane_seen_frontally_is_exact() -> None:
    tsdf = one_view(plane_depth(DOWN), DOWN, GRID)
    height = GRID.centers()[..., 2]
    seen = height > -TRUNCATION
    assert torch.equal(tsdf.weight > 0, seen)
    expected = height.clamp(max=TRUNCATION)
    torch.testing.assert_close(tsdf.distance[seen], expected[seen], atol=1e-5, rtol=0)
    mesh = extract_mesh(tsdf)
    np.testing.assert_allclose(mesh.vertices[:, 2], 0, atol=1e-5)
    assert (mesh.face_normals[:, 2] > 0.999).all()  # towards the camera
    assert mesh.area == pytest.approx(19 * 14 * 0.04**2)  # between the outermost centres


def test_far_readings_are_not_used() -> None:
    near = one_view(plane_depth(DOWN), DOWN, GRID, far=1.6)
    assert near.weight.max() == 1
    too_far = one_view(plane_depth(DOWN), DOWN, GRID, far=1.4)
    assert too_far.weight.max() == 0
    assert len(extract_mesh(too_far).faces) == 0


def test_unknown_readings_observe_nothing() -> None:
    depth = plane_depth(DOWN)
    depth[:, :60] = 0  # the image's left half is world x < 0
    tsdf = one_view(depth, DOWN, GRID)
    observed = (tsdf.weight > 0).any(2).any(1)
    x = GRID.centers()[:, 0, 0, 0]
    assert torch.equal(observed, x > 0)


def test_frames_count_and_distances_are_averaged() -> None:
    """Two frames that measured the plane at 0 and at 4 cm: the mean says 2 cm."""
    depths = [plane_depth(DOWN), plane_depth(DOWN, 0.04)]
    tsdf = fuse(depths, K.expand(2, 3, 3), DOWN.expand(2, 4, 4), GRID, TRUNCATION, FAR)
    height = GRID.centers()[..., 2]
    both = height > 0.04 - TRUNCATION
    assert (tsdf.weight[both] == 2).all()
    assert (tsdf.weight[~both & (height > -TRUNCATION)] == 1).all()
    middle = (height - 0.02).abs() < 0.05
    torch.testing.assert_close(tsdf.distance[middle], height[middle] - 0.02, atol=1e-5, rtol=0)
    np.testing.assert_allclose(extract_mesh(tsdf).vertices[:, 2], 0.02, atol=1e-5)


def test_a_ball_from_eight_sides() -> None:
    center, radius = torch.tensor([0.31, -0.17, 0.55]), 0.4
    grid = VoxelGrid.covering((center - 0.6).tolist(), (center + 0.6).tolist(), 0.04)
    eyes = [
        (1.6 * math.cos(a) + 0.31, 1.6 * math.sin(a) - 0.17, 0.55 + h)
        for a, h in zip(np.arange(8) * math.pi / 4, [-1.2, 1.2] * 4, strict=True)
    ]
    eyes += [(0.35, -0.15, 2.2), (0.35, -0.15, -1.1)]
    poses = torch.stack([look_from(eye, (0.31, -0.17, 0.55)) for eye in eyes])
    depths = [ball_depth(pose, center, radius) for pose in poses]
    tsdf = fuse(depths, K.expand(len(poses), 3, 3), poses, grid, TRUNCATION, FAR)
    true = (grid.centers() - center).norm(dim=-1) - radius
    clear = (true.abs() > 0.03) & (tsdf.weight > 0)
    assert ((tsdf.distance > 0) == (true > 0))[clear].all()
    assert (tsdf.weight > 0)[true.abs() < 0.02].all()
    mesh = extract_mesh(tsdf)
    error = np.abs(np.linalg.norm(mesh.vertices - center.numpy(), axis=1) - radius)
    assert error.mean() < 0.006  # the distances are along the rays: grazing ones are too large
    assert error.max() < 0.025
    assert mesh.is_watertight
    outward = (mesh.triangles_center - center.numpy()) * mesh.face_normals
    assert (outward.sum(1) > 0).mean() > 0.99


def naive(depths: list[Tensor], poses: Tensor, grid: VoxelGrid) -> tuple[np.ndarray, np.ndarray]:
    """Distance and weight over the whole grid, in numpy and double precision."""
    axes = [
        o + (np.arange(n) + 0.5) * grid.voxel for o, n in zip(grid.origin, grid.shape, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    total, weight = np.zeros(len(points)), np.zeros(len(points))
    k = K.numpy().astype(float)
    for depth, pose in zip(depths, poses.numpy().astype(float), strict=True):
        image = depth.numpy()
        camera = (points - pose[:3, 3]) @ pose[:3, :3]
        with np.errstate(divide="ignore", invalid="ignore"):
            column = np.rint(camera[:, 0] / camera[:, 2] * k[0, 0] + k[0, 2])
            row = np.rint(camera[:, 1] / camera[:, 2] * k[1, 1] + k[1, 2])
        inside = (camera[:, 2] > 0) & (column >= 0) & (column < SIZE[0])
        inside &= (row >= 0) & (row < SIZE[1])
        reading = np.zeros(len(points))
        reading[inside] = image[row[inside].astype(int), column[inside].astype(int)]
        signed = reading - camera[:, 2]
        used = (reading > 0) & (reading <= FAR) & (signed > -TRUNCATION)
        total[used] += np.minimum(signed[used], TRUNCATION)
        weight[used] += 1
    return (total / np.maximum(weight, 1)).reshape(grid.shape), weight.reshape(grid.shape)


def test_frustum_blocks_lose_nothing() -> None:
    """Views from within and beside a grid, at odd angles, some that miss it."""
    grid = VoxelGrid((-1.0, -1.1, -0.2), 0.07, (29, 31, 22))
    views = [
        ((-0.9, -0.8, 1.2), (0.3, 0.4, 0.0)),
        ((0.5, 0.5, 0.9), (-0.7, 0.1, 0.2)),
        ((2.5, 0.3, 1.9), (0.0, 0.0, 0.0)),
        ((0.1, -0.2, 3.0), (0.12, -0.22, 0.0)),
        ((5.0, 5.0, 1.0), (9.0, 9.0, 0.5)),
    ]
    poses = torch.stack([look_from(*view) for view in views])
    depths = [plane_depth(pose) for pose in poses]
    depths[1][::3] = 0
    found = fuse(depths, K.expand(5, 3, 3), poses, grid, TRUNCATION, FAR)
    distance, weight = naive(depths, poses, grid)
    # single precision may round a voxel onto the next pixel, or across a bound
    differs = found.weight.numpy() != weight
    assert differs.mean() < 2e-4
    error = np.abs(found.distance.numpy() - distance)[~differs]
    assert np.quantile(error, 0.999) < 1e-5
    assert weight.max() >= 3


def test_a_room() -> None:
    """Fused from 10 small frames: close to the analytic walls and box."""
    poses = torch.from_numpy(np.stack(box_room.poses())).float()[::2]
    depths = [torch.from_numpy(box_room.depth_image(p.numpy())).float() for p in poses]
    k = torch.from_numpy(box_room.intrinsics()).float().expand(len(poses), 3, 3)
    grid = VoxelGrid.covering(box_room.ROOM[0] - 0.2, box_room.ROOM[1] + 0.2, 0.05)
    tsdf = fuse(depths, k, poses, grid, TRUNCATION, FAR)
    centers = grid.centers().numpy().reshape(-1, 3)
    true = torch.from_numpy(box_room.signed_distance(centers)).float().view(grid.shape)
    observed = tsdf.weight > 0
    # half a pixel is 2 cm at 2 m in these small images
    assert (tsdf.distance - true)[observed & (true.abs() < 0.02)].abs().mean() < 0.01
    assert ((tsdf.distance > 0) == (true > 0))[observed & (true.abs() > 0.03)].float().mean() > 0.99
    assert (tsdf.distance[observed & (true > 0.3)] > TRUNCATION - 1e-5).all()
    assert not observed[true < -0.25].any()
    mesh = extract_mesh(tsdf)
    off = np.abs(box_room.signed_distance(np.asarray(mesh.vertices)))
    assert off.mean() < 0.007
    assert np.quantile(off, 0.99) < 0.02
    # what the cameras see is there: each of a sample of true surface points has a vertex nearby
    points = torch.cat([unproject(d, k[0], p) for d, p in zip(depths, poses, strict=True)])[::17]
    distance, _ = cKDTree(mesh.vertices).query(points.numpy())
    assert np.quantile(distance, 0.98) < 0.05


def test_unprojected_points_lie_on_the_surface() -> None:
    pose = look_from((0.2, -0.3, 1.2), (1.0, 0.5, 0.0))
    depth = plane_depth(pose)
    points = unproject(depth, K, pose)
    assert len(points) == (depth > 0).sum()
    assert points[:, 2].abs().max() < 1e-4
    # the pixel at the principal point, half a pixel off the centre, looks at the target
    distance = (points[:, :2] - torch.tensor([1.0, 0.5])).norm(dim=-1)
    assert distance.min() < 0.02


def test_bounds() -> None:
    depths = [plane_depth(DOWN), torch.zeros(SIZE[1], SIZE[0])]
    lower, upper = bounds_of(depths, K.expand(2, 3, 3), DOWN.expand(2, 4, 4), 0.1, stride=1)
    reach = [1.5 * 59.5 / 100 + 0.1, 1.5 * 44.5 / 100 + 0.1]
    assert upper.tolist() == pytest.approx([*reach, 0.1], abs=1e-4)
    assert lower.tolist() == pytest.approx([-reach[0], -reach[1], -0.1], abs=1e-4)
    with pytest.raises(TFLabError, match="no depth reading"):
        bounds_of(depths[1:], K[None], DOWN[None], 0.1)


@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_slabs_equal_the_whole(rows: int) -> None:
    depths, k, poses, grid = corridor(3.0, 0.05)
    whole = fuse(depths, k, poses, grid, TRUNCATION, FAR)
    memory = BYTES * (rows + 1) * grid.shape[1] * grid.shape[2]
    parts = list(fuse_in_slabs(depths, k, poses, grid, TRUNCATION, FAR, memory))
    assert len(parts) == math.ceil(grid.shape[0] / rows)
    distance = torch.cat([part.distance[:own] for own, part in parts])
    weight = torch.cat([part.weight[:own] for own, part in parts])
    assert torch.equal(weight, whole.weight)
    torch.testing.assert_close(distance, whole.distance, atol=1e-5, rtol=0)
    mesh, expected = join([extract_mesh(part) for _, part in parts]), extract_mesh(whole)
    assert mesh.area == pytest.approx(expected.area, rel=1e-6)
    assert len(mesh.vertices) == len(expected.vertices)  # seams have merged
    assert len(mesh.faces) == len(expected.faces)


@pytest.mark.parametrize("focal", [8.0, 40.0])
def test_slabs_equal_the_whole_for_any_lens(focal: float) -> None:
    """A camera amid a room that sees more than 150 degrees, and one that sees less."""
    size, distance = 64, 1.0
    k = torch.tensor([[focal, 0, 31.5], [0, focal, 31.5], [0, 0, 1]])[None]
    depth, reach = torch.full((size, size), distance), distance * size / 2 / focal + 0.2
    n = math.ceil(2 * reach / 0.05)
    grid = VoxelGrid((-reach, -reach, 0.0), 0.05, (n, n, 24))
    whole = fuse([depth], k, torch.eye(4)[None], grid, TRUNCATION, FAR)
    assert int((whole.weight > 0).sum()) > 0.5 * n * n
    memory = BYTES * 9 * grid.shape[1] * grid.shape[2]
    parts = list(fuse_in_slabs([depth], k, torch.eye(4)[None], grid, TRUNCATION, FAR, memory))
    assert torch.equal(torch.cat([part.weight[:own] for own, part in parts]), whole.weight)


MEASURE = """
import resource, sys, torch
sys.path[:] = {path!r}
from helpers.depth_views import FAR, TRUNCATION, corridor
from tf_lab.data.tsdf import fuse_in_slabs
torch.set_num_threads(1)
depths, k, poses, grid = corridor({length}, 0.02)
list(fuse_in_slabs(depths[:2], k, poses, corridor(0.5, 0.02)[3], TRUNCATION, FAR))  # libraries
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
voxels = 0
for own, part in fuse_in_slabs(depths, k, poses, grid, TRUNCATION, FAR, {memory}):
    voxels += part.weight[:own].numel()
print(voxels, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024)
"""


def test_memory_stays_within_the_budget_on_a_larger_scene() -> None:
    """Eight times the volume: the budget bounds both."""
    memory, found = 64 * 2**20, []
    for length in (3.6, 28.8):
        code = MEASURE.format(path=sys.path, length=length, memory=memory)
        command = [sys.executable, "-c", code]
        output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        found.append([int(word) for word in output.split()])
    (small, _), (large, peak) = found
    assert large > 7.5 * small
    assert large * 8 > 1.5 * memory  # the sums alone would not fit
    assert peak < memory, (peak, memory)
