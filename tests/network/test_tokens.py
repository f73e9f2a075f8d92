"""Tokens: which inputs they read, and the sampling of features, by hand on a toy."""

import pytest
import torch
from torch import Tensor

from tf_lab.geometry import sample_maps
from tf_lab.network.tokens import Measurements, Tokens, measure

C, D = 5, 16


def measured(maps: Tensor, points: Tensor, K: Tensor, world_T_cam: Tensor) -> Measurements:
    """By views of 8x4 pixels."""
    return measure(
        points,
        K,
        world_T_cam,
        torch.linalg.inv(world_T_cam),
        (8, 4),
        (0.3, 5.0),
        lambda uv: sample_maps(maps, uv, (8, 4)),
    )


def make(depth: bool = True, ray: bool = True) -> Tokens:
    torch.manual_seed(1)
    tokens = Tokens(C, D, depth, ray)
    torch.nn.init.normal_(tokens.linear.weight)
    torch.nn.init.normal_(tokens.linear.bias)
    return tokens


def measurements(n: int = 7) -> Measurements:
    torch.manual_seed(2)
    valid = torch.arange(n) % 2 == 0
    ray = torch.nn.functional.normalize(torch.randn(n, 3), dim=-1)
    phi, depth = torch.randn(n, C), 0.5 + 4 * torch.rand(n)
    return Measurements(phi, depth, valid, ray, torch.zeros(n, 0))


@pytest.mark.parametrize(
    ("depth", "ray", "inputs"),
    [(True, True, C + 5), (False, True, C + 4), (True, False, C + 2), (False, False, C + 1)],
)
def test_inputs_without_depth_or_ray(depth: bool, ray: bool, inputs: int) -> None:
    tokens = make(depth, ray)
    assert tokens.linear.in_features == inputs
    m = measurements()
    first = tokens(m)
    assert first.shape == (7, D)
    assert torch.equal(tokens(m._replace(depth=m.depth + 0.3)), first) is not depth
    assert torch.equal(tokens(m._replace(ray=m.ray.flip(0))), first) is not ray


def test_a_valid_token_reads_features_and_validity() -> None:
    tokens = make()
    m = measurements()
    first = tokens(m)
    assert ((tokens(m._replace(phi=m.phi + 1)) - first).abs().amax(-1) > 1e-3)[m.valid].all()
    assert ((tokens(m._replace(valid=~m.valid)) - first).abs().amax(-1) > 1e-3).all()


def test_features_of_an_invalid_projection_do_not_matter() -> None:
    tokens = make()
    m = measurements()
    other = torch.where(m.valid[:, None], m.phi, 1e3 * torch.ones_like(m.phi))
    assert torch.equal(tokens(m._replace(phi=other)), tokens(m))


def test_a_token_is_linear_in_what_it_reads() -> None:
    """theta = W [phi, d, v, r] + b for some order of the inputs and some affine scale of depth."""
    tokens = make()
    m = measurements(200)._replace(valid=torch.ones(200, dtype=torch.bool))
    inputs = torch.cat([m.phi, m.depth[:, None], m.ray, torch.ones(200, 1)], 1)
    theta = tokens(m)
    residual = theta - inputs @ torch.linalg.lstsq(inputs, theta).solution
    assert residual.abs().max() < 1e-4


def test_measurements_of_two_views_by_hand() -> None:
    """An 8x4 image with maps of stride 2; the first camera looks along x, the second along -z."""
    K = torch.tensor([[4.0, 0, 3.5], [0, 4.0, 1.5], [0, 0, 1]]).expand(2, 3, 3)
    poses = torch.eye(4).repeat(2, 1, 1)
    # columns: the camera's right, down and forward in the world
    poses[0, :3, :3] = torch.tensor([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    poses[1, :3, :3] = torch.tensor([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    poses[1, :3, 3] = torch.tensor([2.0, 0.0, 4.0])
    maps = torch.arange(16.0).view(2, 1, 2, 4)  # rows of 4: 0..3, 4..7 and 8..11, 12..15
    points = torch.tensor([[2.0, 0.0, 0.0], [2.0, -0.5, 0.25], [2.0, 30.0, 0.0], [-3.0, 0.0, 0.0]])
    phi, depth, valid, ray, _ = measured(maps, points, K, poses)
    # First view: right = -y, down = -z, so (u, v) = (3.5 + 4 * -y / 2, 1.5 + 4 * -z / 2).
    # Point 0: the image's centre, hence the mean of the map. Point 1: (4.5, 1.0), on the map
    # ((u + .5) / 2 - .5, (v + .5) / 2 - .5) = (2, .25), value 2 + .25 * 4 = 3.
    assert phi[0, :2, 0].tolist() == pytest.approx([3.5, 3.0])
    assert depth[0].tolist() == pytest.approx([2, 2, 2, -3])
    assert valid[0].tolist() == [True, True, False, False]
    # Second view: right = x, down = -y, 4 m up. Point 1 has depth 3.75 and
    # (u, v) = (3.5, 1.5 + 4 * .5 / 3.75), on the map (1.5, .5 + 4 * .5 / 3.75 / 2).
    assert phi[1, :2, 0].tolist() == pytest.approx([11.5, 9.5 + 4 * (0.5 + 4 * 0.5 / 3.75 / 2)])
    assert depth[1].tolist() == pytest.approx([4, 3.75, 4, 4])
    assert valid[1].tolist() == [True, True, False, False]
    assert ray[0, 0].tolist() == pytest.approx([1, 0, 0])
    assert ray[1, 1].tolist() == pytest.approx([0, -0.5 / 14.3125**0.5, -3.75 / 14.3125**0.5])
    torch.testing.assert_close(ray.norm(dim=-1), torch.ones(2, 4))


@pytest.mark.parametrize("depth", [0.29, 0.31, 4.9, 5.1])
def test_the_depth_range_bounds_validity(depth: float) -> None:
    K = torch.tensor([[[4.0, 0, 3.5], [0, 4.0, 1.5], [0, 0, 1]]])
    point = torch.tensor([[0, 0, depth]])
    valid = measured(torch.zeros(1, 1, 2, 4), point, K, torch.eye(4)[None]).valid
    assert valid.item() is (0.3 < depth < 5.0)
