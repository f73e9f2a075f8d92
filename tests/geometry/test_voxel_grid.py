"""`tf_lab.geometry.VoxelGrid`: cell-centred, axes in order, levels that line up."""

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, strategies as st

from tf_lab.geometry import VoxelGrid, transform

coordinates = st.tuples(*[st.floats(-5, 5)] * 3)
extents = st.tuples(*[st.floats(0, 3)] * 3)


@given(coordinates, extents, st.sampled_from([0.04, 0.1]), st.sampled_from([1, 3]))
def test_covering_grid_covers_tightly_on_the_lattice(
    lower: tuple[float, ...], extent: tuple[float, ...], voxel: float, multiple: int
) -> None:
    upper = [a + e for a, e in zip(lower, extent, strict=True)]
    grid = VoxelGrid.covering(lower, upper, voxel, multiple)
    cell = voxel * multiple
    for axis in range(3):
        start, count = grid.origin[axis], grid.shape[axis]
        end = start + count * voxel
        assert start / cell == pytest.approx(round(start / cell), abs=1e-6)
        assert count % multiple == 0
        assert count > 0
        assert start - 1e-6 <= lower[axis] < start + cell + 1e-6
        assert end >= upper[axis] - 1e-6
        assert end - cell <= max(upper[axis], start) + 1e-6


def test_covering_an_exact_box_adds_nothing() -> None:
    grid = VoxelGrid.covering([0.3, -0.6, 0.0], [1.8, 0.9, 1.5], 0.1, multiple=3)
    assert grid.shape == (15, 15, 15)
    assert grid.origin == pytest.approx((0.3, -0.6, 0.0))


def test_a_lattice_is_that_of_the_voxels_unless_told() -> None:
    grid = VoxelGrid.covering([0.11, 0.21, 0.31], [0.19, 0.29, 0.39], 0.1)
    assert grid.shape == (1, 1, 1)
    assert grid.origin == pytest.approx((0.1, 0.2, 0.3))


def test_centers_and_index_by_hand() -> None:
    grid = VoxelGrid((1.0, 2.0, 3.0), 0.5, (2, 3, 4))
    centers = grid.centers()
    assert centers.shape == (2, 3, 4, 3)
    assert centers[0, 0, 0].tolist() == [1.25, 2.25, 3.25]
    assert centers[1, 2, 3].tolist() == [1.75, 3.25, 4.75]
    assert grid.to_index(centers)[1, 2, 3].tolist() == [1, 2, 3]
    assert grid.to_index(torch.tensor([1.0, 2.0, 3.0])).tolist() == [-0.5, -0.5, -0.5]
    index = torch.tensor([[1.0, 2.0, 3.0]], dtype=torch.float64)
    assert transform(grid.world_T_index, index)[0].tolist() == [1.75, 3.25, 4.75]


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_volume_samples_of_a_linear_function_are_exact(dtype: torch.dtype) -> None:
    grid = VoxelGrid((-0.2, 1.0, 0.4), 0.1, (5, 9, 13))  # unequal sides: swapped axes show
    weights = torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    volume = (grid.centers() @ weights).movedim(-1, 0).to(dtype)
    inner = torch.tensor(grid.shape) - 1
    index = torch.rand(100, 3, generator=torch.Generator().manual_seed(0)) * inner
    points = torch.tensor(grid.origin) + (index + 0.5) * grid.voxel
    samples = grid.sample(volume, points)
    both = grid.sample(torch.stack([volume, 2 * volume]), points.expand(2, -1, -1))
    torch.testing.assert_close(both, torch.stack([samples, 2 * samples]))
    tolerance = 1e-5 if dtype == torch.float32 else 8e-3  # bfloat16 holds 8 bits of the value
    torch.testing.assert_close(samples.float(), points, atol=tolerance, rtol=tolerance)


def test_volume_samples_outside() -> None:
    grid = VoxelGrid((0.0, 0.0, 0.0), 1.0, (2, 3, 4))
    far = torch.tensor([[-5.0, 1.5, 1.5]])
    assert grid.sample(torch.ones(1, 2, 3, 4), far).item() == 1
    assert grid.sample(torch.ones(1, 2, 3, 4), far, padding="zeros").item() == 0


def test_coarse_cells_repeated_three_times_contain_the_fine_centres() -> None:
    origin = (0.3, -1.2, 0.6)
    coarse, fine = VoxelGrid(origin, 0.3, (5, 5, 5)), VoxelGrid(origin, 0.1, (15, 15, 15))
    axes = torch.arange(5).repeat_interleave(3)
    repeated = torch.stack(torch.meshgrid(axes, axes, axes, indexing="ij"), dim=-1)
    containing = coarse.to_index(fine.centers()).round().long()
    assert torch.equal(containing, repeated)
    upsampled = F.interpolate(torch.arange(125.0).reshape(1, 1, 5, 5, 5), scale_factor=3)
    i, j, k = repeated.unbind(-1)
    assert torch.equal(upsampled[0, 0], (i * 25 + j * 5 + k).float())


def test_blocks_and_refined_grids_lie_in_their_grid() -> None:
    grid = VoxelGrid((-1.0, 0.5, 0.25), 0.25, (4, 5, 6))
    block = grid.block((1, 0, 2), (4, 2, 3))
    assert block.shape == (3, 2, 1)
    torch.testing.assert_close(block.centers(), grid.centers()[1:4, 0:2, 2:3])
    fine = grid.refined(2)
    assert (fine.origin, fine.voxel, fine.shape) == (grid.origin, 0.125, (8, 10, 12))
    parts = fine.centers().view(4, 2, 5, 2, 6, 2, 3)
    torch.testing.assert_close(parts.mean((1, 3, 5)), grid.centers())
