"""Frusta against the projection of random points."""

import itertools

import pytest
import torch

from tf_lab.geometry import frustum_corners, frustum_planes, in_view, invert_pose, project
from tf_lab.online.lattice.blocks import voxels_in

CPU = torch.device("cpu")


@pytest.mark.parametrize("seed", range(5))
def test_the_box_of_a_frustum_holds_all_that_the_camera_sees(seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    rotation, _ = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = rotation * torch.linalg.det(rotation)
    pose[:3, 3] = torch.randn(3, generator=generator)
    K = torch.tensor([[40.0, 0, 31], [0, 42.0, 20], [0, 0, 1]], dtype=torch.float64)
    corners = frustum_corners(K, pose, (64, 48), 0.3, 2.0)
    low, high = corners.amin(0), corners.amax(0)
    ends = torch.tensor([-0.5, -0.5, 0.3]), torch.tensor([63.5, 47.5, 2.0])
    u, v, z = (ends[0] + (ends[1] - ends[0]) * torch.rand(500, 3, generator=generator)).T.double()
    camera = torch.stack([u * z, v * z, z], 1) @ torch.linalg.inv(K).T
    world = camera @ pose[:3, :3].T + pose[:3, 3]
    assert (world.amin(0) >= low).all()
    assert (world.amax(0) <= high).all()
    assert (world.amin(0) < low + 0.8).all()  # and is not much larger
    voxels = {tuple(v) for v in voxels_in(low, high, 0.1, CPU).tolist()}
    assert {tuple(v) for v in (world / 0.1).floor().long().tolist()} <= voxels
    planes = frustum_planes(K, pose, (64, 48), 0.3, 2.0)
    torch.testing.assert_close(planes[:, :3].norm(dim=1), torch.ones(6, dtype=torch.float64))
    points = pose[:3, 3] + 4 * (torch.rand(3000, 3, generator=generator).double() - 0.5)
    uv, z = project(points, K, invert_pose(pose))
    inside = (points @ planes[:, :3].T + planes[:, 3] >= 0).all(1)
    assert torch.equal(inside, in_view(uv, z, (64, 48), 0.3, 2.0))
    assert 0 < inside.sum() < len(inside)


def test_corners_are_those_of_the_image_near_and_far() -> None:
    """Also of several cameras at once, and planes with them."""
    K = torch.tensor([[40.0, 0, 31], [0, 42.0, 20], [0, 0, 1]], dtype=torch.float64)
    poses = torch.eye(4, dtype=torch.float64).repeat(3, 1, 1)
    poses[1, :3, 3] = torch.tensor([1.0, -2, 3])
    poses[2, :3, :3] = torch.tensor([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    corners = frustum_corners(K, poses, (64, 48), 0.3, 2.0)
    planes = frustum_planes(K.expand(3, 3, 3), poses, (64, 48), 0.3, 2.0)
    for pose, eight, six in zip(poses, corners, planes, strict=True):
        uv, z = project(eight, K, invert_pose(pose))
        found = {tuple(x) for x in torch.column_stack([uv, z]).round(decimals=6).tolist()}
        assert found == {*itertools.product((-0.5, 63.5), (-0.5, 47.5), (0.3, 2.0))}
        touched = (eight @ six[:, :3].T + six[:, 3]).abs() < 1e-9
        assert (touched.sum(1) == 3).all() and (touched.sum(0) == 4).all()  # as of any hexahedron
