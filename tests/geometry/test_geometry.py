"""The conventions of `tf_lab.geometry`, against hand-computed values, algebra and scipy."""

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.geometry import (
    check_focal,
    in_view,
    invert_pose,
    is_valid_pose,
    pixel_directions,
    pose_distance,
    project,
    rotation_about_z,
    rotation_between,
    sample_maps,
    scale_intrinsics,
    transform,
    view_rays,
)

F64 = torch.float64
SIZE = (64, 48)
K = torch.tensor([[50.0, 0.0, 30.5], [0.0, 60.0, 22.25], [0.0, 0.0, 1.0]], dtype=F64)


@pytest.fixture(autouse=True)
def seeded() -> None:
    torch.manual_seed(0)


unit = st.floats(-1, 1)
vectors = st.tuples(unit, unit, unit).filter(lambda v: np.linalg.norm(v) > 0.1)


@st.composite
def poses(draw: st.DrawFn) -> Tensor:
    pose = torch.eye(4, dtype=F64)
    turn = Rotation.from_rotvec(math.pi * np.array(draw(st.tuples(unit, unit, unit))))
    pose[:3, :3] = torch.from_numpy(turn.as_matrix())
    pose[:3, 3] = 5 * torch.tensor(draw(st.tuples(unit, unit, unit)), dtype=F64)
    return pose


def camera_at(position: list[float]) -> Tensor:
    """world_T_cam of a camera that looks along +y in a z-up world."""
    pose = torch.eye(4, dtype=F64)
    pose[:3, :3] = torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # columns: right, down, fwd
    pose[:3, 3] = torch.tensor(position)
    return pose


def test_project_by_hand() -> None:
    camera = camera_at([1.0, -2.0, 1.5])
    points = torch.tensor([[1.0, 0.0, 1.5], [1.4, 2.0, 1.5], [1.0, 0.0, 1.8]], dtype=F64)
    uv, depth = project(points, K, invert_pose(camera))
    # ahead; 0.4 m right at 4 m; 0.3 m higher (smaller v) at 2 m
    expected = [[30.5, 22.25], [30.5 + 50 * 0.4 / 4, 22.25], [30.5, 22.25 - 60 * 0.3 / 2]]
    torch.testing.assert_close(uv, torch.tensor(expected, dtype=F64))
    torch.testing.assert_close(depth, torch.tensor([2.0, 4.0, 2.0], dtype=F64))


def test_project_behind_and_beside_the_camera_is_finite() -> None:
    points = torch.tensor([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], dtype=F64)
    uv, depth = project(points, K, torch.eye(4, dtype=F64))
    assert torch.isfinite(uv).all()
    assert depth.tolist() == [-1.0, 0.0, 0.0]


@given(poses(), st.floats(0.1, 10), st.floats(-0.5, 63.4), st.floats(-0.5, 47.4))
def test_unproject_then_project_returns_the_pixel(
    world_T_cam: Tensor, depth: float, u: float, v: float
) -> None:
    ray = torch.tensor([(u - 30.5) / 50, (v - 22.25) / 60, 1.0], dtype=F64)
    uv, z = project(transform(world_T_cam, depth * ray[None]), K, invert_pose(world_T_cam))
    torch.testing.assert_close(uv[0], torch.tensor([u, v], dtype=F64), atol=1e-7, rtol=0)
    assert z.item() == pytest.approx(depth)


def test_pixel_directions_project_to_their_pixels() -> None:
    directions = pixel_directions(K, SIZE)
    assert directions.shape == (48, 64, 3)
    uv, z = project(directions.reshape(-1, 3), K, torch.eye(4, dtype=F64))
    expected = [[u, v] for v in range(48) for u in range(64)]
    torch.testing.assert_close(uv, torch.tensor(expected, dtype=F64))
    assert (z == 1).all()


def test_projection_broadcasts_over_views() -> None:
    cameras = torch.stack([camera_at([0.0, -2.0, 1.0]), camera_at([0.5, -3.0, 1.0])])
    points = torch.rand(7, 3, dtype=F64)
    uv, depth = project(points, K.expand(2, 3, 3), invert_pose(cameras))
    for view in range(2):
        one, z = project(points, K, invert_pose(cameras[view]))
        torch.testing.assert_close(uv[view], one)
        torch.testing.assert_close(depth[view], z)


def test_autocast_rounds_no_coordinate() -> None:
    """A network that computes in half precision still has to look at the right pixel."""
    camera = camera_at([0.3, -2.0, 1.1]).float()
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
    exact = project(points, K.float(), invert_pose(camera))
    with torch.autocast("cpu", torch.bfloat16):
        found = project(points, K.float(), invert_pose(camera))
    for a, b in zip(found, exact, strict=True):
        torch.testing.assert_close(a, b, atol=0, rtol=0)


@pytest.mark.parametrize("to_size", [(32, 24), (128, 96), (16, 24), (100, 31)])
def test_scale_intrinsics_keeps_image_corners(to_size: tuple[int, int]) -> None:
    scaled = scale_intrinsics(K, SIZE, to_size)
    corners = torch.tensor([[-0.5, -0.5, 1.0], [63.5, 47.5, 1.0]], dtype=F64)
    moved = corners @ torch.linalg.inv(K).T @ scaled.T  # pixel -> ray -> pixel of the new image
    expected = [[-0.5, -0.5, 1.0], [to_size[0] - 0.5, to_size[1] - 0.5, 1.0]]
    torch.testing.assert_close(moved, torch.tensor(expected, dtype=F64))


@given(poses(), vectors)
def test_projecting_commutes_with_resizing(world_T_cam: Tensor, point: tuple[float, ...]) -> None:
    in_camera = torch.tensor([point], dtype=F64) + torch.tensor([0.0, 0.0, 2.0], dtype=F64)
    points, cam_T_world = transform(world_T_cam, in_camera), invert_pose(world_T_cam)
    uv, _ = project(points, K, cam_T_world)
    small, _ = project(points, scale_intrinsics(K, SIZE, (32, 12)), cam_T_world)
    resized = (uv + 0.5) * torch.tensor([0.5, 0.25], dtype=F64) - 0.5
    torch.testing.assert_close(small, resized, atol=1e-8, rtol=1e-8)


def ramp(a: float, b: float, c: float) -> Tensor:
    v, u = torch.meshgrid(torch.arange(48), torch.arange(64), indexing="ij")
    return (a * u.double() + b * v.double() + c)[None, None]


@pytest.mark.parametrize("stride", [1, 2, 4, 8])
def test_sampling_an_area_averaged_ramp_returns_the_ramp(stride: int) -> None:
    a, b, c = 0.7, -1.3, 5.0
    maps = F.avg_pool2d(ramp(a, b, c), stride)
    lowest = stride / 2 - 0.5  # the first map cell's centre; outside, the border is repeated
    span = torch.tensor(SIZE, dtype=F64) - 1 - 2 * lowest
    uv = lowest + torch.rand(1, 200, 2, dtype=F64) * span
    expected = a * uv[..., 0] + b * uv[..., 1] + c
    torch.testing.assert_close(sample_maps(maps, uv, SIZE)[..., 0], expected)


def test_samples_at_pixel_centres_are_the_pixels() -> None:
    maps = torch.rand(2, 3, 48, 64)
    uv = torch.tensor([[0.0, 0.0], [63.0, 0.0], [0.0, 47.0], [17.0, 31.0]]).expand(2, 4, 2)
    u, v = uv[0].long().unbind(-1)
    torch.testing.assert_close(sample_maps(maps, uv, SIZE), maps[:, :, v, u].transpose(1, 2))


def test_samples_beyond_the_border_are_the_border_and_finite() -> None:
    maps = torch.rand(1, 1, 48, 64)
    uv = torch.tensor([[[-1e9, 5.0], [1e9, 5.0], [-0.5, 5.0]]])
    expected = maps[0, 0, 5, [0, 63, 0]]
    torch.testing.assert_close(sample_maps(maps, uv, SIZE)[0, :, 0], expected)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_maps_are_sampled_at_exact_coordinates(dtype: torch.dtype) -> None:
    maps = torch.arange(1280).remainder(2).to(dtype).expand(1, 1, 4, 1280)  # 0, 1, 0, 1, ...
    uv = torch.tensor([[[1202.0, 1.0], [1203.0, 1.0], [1203.25, 1.0]]])
    samples = sample_maps(maps, uv, (1280, 4))
    assert samples.dtype == dtype
    expected = torch.tensor([0.0, 1.0, 0.75])
    torch.testing.assert_close(samples[0, :, 0].float(), expected, atol=4e-3, rtol=0)


def test_in_view_borders() -> None:
    uv = torch.tensor([[-0.5, 0], [-0.51, 0], [63.49, 0], [63.5, 0], [0, -0.51], [0, 47.5], [9, 9]])
    inside = in_view(uv, torch.ones(7), SIZE, 0.1, 4.0)
    assert inside.tolist() == [True, False, True, False, False, False, True]
    depth = torch.tensor([-1.0, 0.05, 0.5, 4.0, 4.1, math.nan])
    inside = in_view(torch.full((6, 2), 9.0), depth, SIZE, 0.1, 4.0)
    assert inside.tolist() == [False, False, True, True, False, False]


@given(poses(), vectors)
def test_view_rays_point_from_camera_to_point(
    world_T_cam: Tensor, offset: tuple[float, ...]
) -> None:
    step = torch.tensor(offset, dtype=F64)
    ray = view_rays((world_T_cam[:3, 3] + step)[None], world_T_cam)[0]
    torch.testing.assert_close(ray, step / step.norm(), atol=1e-9, rtol=0)


@given(poses(), vectors)
def test_invert_pose(pose: Tensor, point: tuple[float, ...]) -> None:
    torch.testing.assert_close(invert_pose(pose), torch.linalg.inv(pose), atol=1e-9, rtol=0)
    points = torch.tensor([point], dtype=F64)
    torch.testing.assert_close(transform(invert_pose(pose), transform(pose, points)), points)


@given(poses())
def test_rigid_poses_are_valid(pose: Tensor) -> None:
    assert is_valid_pose(pose)
    assert is_valid_pose(pose.float())


def test_invalid_poses() -> None:
    bad = torch.eye(4).repeat(8, 1, 1)
    bad[0, 0, 3] = math.nan
    bad[1, 1, 1] = math.inf
    bad[2, 2, 3] = -math.inf
    bad[3, 0, 0] = -1  # mirrored
    bad[4, :3, :3] *= 1.1  # scaled
    bad[5, 0, 1] = 0.1  # sheared
    bad[6, 3, 0] = 1  # projective
    bad[7] = 0
    assert is_valid_pose(bad).tolist() == [False] * 8
    for one in bad:
        assert is_valid_pose(torch.stack([one, torch.eye(4)])).tolist() == [False, True]


@given(vectors, vectors)
def test_rotation_between_is_the_smallest_rotation(
    first: tuple[float, ...], second: tuple[float, ...]
) -> None:
    a, b = (torch.tensor(v, dtype=F64) for v in (first, second))
    rotation = rotation_between(a, b)
    torch.testing.assert_close(rotation @ (a / a.norm()), b / b.norm(), atol=1e-7, rtol=0)
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3, dtype=F64))
    assert torch.linalg.det(rotation).item() == pytest.approx(1)
    between = math.atan2(torch.linalg.cross(a, b).norm().item(), torch.dot(a, b).item())
    turned = Rotation.from_matrix(rotation.numpy()).magnitude()
    assert turned == pytest.approx(between, abs=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-7, 1e-5, 1e-3, 1e-2])
def test_rotation_between_nearly_opposite_directions(dtype: torch.dtype, gap: float) -> None:
    a = torch.tensor([0.6, 0.0, 0.8], dtype=dtype)
    b = torch.tensor([-0.6, gap, -0.8], dtype=dtype)
    rotation = rotation_between(a, b)
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3, dtype=dtype))
    torch.testing.assert_close(rotation @ a, b / b.norm(), atol=1e-6, rtol=0)


def test_rotation_between_identical_directions_is_exactly_identity() -> None:
    down = torch.tensor([0.0, 0.0, -1.0], dtype=F64)
    assert torch.equal(rotation_between(down, down), torch.eye(3, dtype=F64))


def test_rotation_about_z() -> None:
    turned = rotation_about_z(math.pi / 2) @ torch.tensor([1.0, 0.0, 3.0])
    torch.testing.assert_close(turned, torch.tensor([0.0, 1.0, 3.0]), atol=1e-6, rtol=0)
    expected = torch.from_numpy(Rotation.from_rotvec([0, 0, 0.4]).as_matrix()).float()
    torch.testing.assert_close(rotation_about_z(0.4), expected)


@pytest.mark.parametrize("angle", [0.0, 0.1, 1.0, math.pi])
def test_how_far_apart_poses_are(angle: float) -> None:
    """Of DeepVideoMVS; about any axis the trace of a rotation is 1 + 2 cos(angle)."""
    a, b = np.tile(np.eye(4), (2, 1, 1)), np.tile(np.eye(4), (2, 1, 1))
    a[:, :3, 3] = b[:, :3, 3] = [5, -6, 7]
    a[:, :3, :3] = Rotation.from_rotvec([0.3, 0.2, -1]).as_matrix()
    turn = Rotation.from_rotvec(angle * np.array([2, -1, 2]) / 3).as_matrix()
    b[:, :3, :3] = a[:, :3, :3] @ turn
    b[1, :3, 3] += [0.03, 0.04, 0.12]
    combined, rotation, translation = (x[:, 0] for x in pose_distance(a[:, None], b[:, None]))
    measure = math.sqrt(4 / 3 * (1 - math.cos(angle)))
    np.testing.assert_allclose(rotation, measure, atol=1e-7)
    np.testing.assert_allclose(translation, [0, 0.13], atol=1e-12)
    np.testing.assert_allclose(combined, [measure, math.hypot(measure, 0.13)], atol=1e-7)


def test_a_pose_is_no_rotation_from_itself() -> None:
    """Though rounding makes its trace larger than 3."""
    poses = np.tile(np.eye(4), (1000, 1, 1))
    poses[:, :3, :3] = Rotation.random(1000, random_state=0).as_matrix()
    poses[:, :3, :3] *= 1 + 1e-12
    assert (pose_distance(poses, poses)[0] == 0).all()


def test_focal_lengths_that_cannot_be_in_pixels() -> None:
    check_focal(64.0, 48.0, 31.5, 23.5, SIZE)
    check_focal(5.0, 2.5, 31.5, 23.5, (100, 50))  # 2 atan(1 / (2 * 0.05)) = 168.6 degrees
    for fx, fy, expected in (
        *((0.0, 50.0, "fx = 0, fy = 50 must be positive"), (50.0, 0.0, "must be positive")),
        *((3.0, 50.0, "too short for images of 64x48 .* in pixels"), (50.0, 2.0, "too short")),
        (math.nan, 50.0, "must be positive"),
    ):
        with pytest.raises(TFLabError, match=expected):
            check_focal(fx, fy, 31.5, 23.5, SIZE)
    with pytest.raises(TFLabError, match=r"multiply fx, cx by its width and fy, cy by its height"):
        check_focal(0.8, 1.1, 0.5, 0.5, SIZE)
    with pytest.raises(TFLabError, match=r"give them in pixels"):
        check_focal(0.8, 1.1, 32.0, 0.5, SIZE)
