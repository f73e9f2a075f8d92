"""Refinement: local, independent of the volume's extent, silent where nothing is known."""

import pytest
import torch
from torch import Tensor, nn

from tf_lab.network.refinement import ChannelNorm, Refinement, ResidualBlock3d

WIDTH, REACH = 6, 7  # 3 blocks of two 3x3x3 convolutions and the mask head's one


def make(blocks: int) -> Refinement:
    torch.manual_seed(0)
    module = Refinement(WIDTH, blocks).eval()
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return module


def volume(*shape: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Features [1, D, X, Y, Z], zero where inactive, and a mask of which 80 % is active."""
    generator = torch.Generator().manual_seed(seed)
    active = torch.rand(1, *shape, generator=generator) < 0.8
    psi = torch.randn(1, WIDTH, *shape, generator=generator)
    return psi * active[:, None], active


@pytest.mark.parametrize("blocks", [3, 0])
def test_shapes(blocks: int) -> None:
    refinement = make(blocks)
    psi, seen = volume(4, 3, 2)
    fine_psi, active = volume(12, 9, 6)
    coarse, coarse_logits = refinement.coarse(psi, seen)
    fine, fine_logits = refinement.fine(coarse, fine_psi, active)
    assert coarse.shape == (1, WIDTH, 4, 3, 2)
    assert coarse_logits.shape == (1, 4, 3, 2)
    assert fine.shape == (1, WIDTH, 12, 9, 6)
    assert fine_logits.shape == (1, 12, 9, 6)


def test_a_chunk_equals_the_same_part_of_a_larger_scene() -> None:
    refinement = make(3)
    psi, seen = volume(20, 17, 18)
    x, y, z = slice(2, 19), slice(1, 17), slice(0, 18)
    whole, whole_logits = refinement.coarse(psi, seen)
    part, part_logits = refinement.coarse(psi[..., x, y, z], seen[:, x, y, z])
    inner = (slice(REACH, 17 - REACH), slice(REACH, 16 - REACH), slice(0, 18))
    outer = tuple(slice(s.start + o, s.stop + o) for s, o in zip(inner, (2, 1, 0), strict=True))
    (a, b, c), (i, j, k) = inner, outer
    for found, expected in ((part, whole), (part_logits, whole_logits)):
        torch.testing.assert_close(
            found[..., a, b, c], expected[..., i, j, k], atol=1e-5, rtol=1e-5
        )


def test_a_voxel_reaches_seven_voxels_and_no_further() -> None:
    refinement = make(3)
    psi, _ = volume(17, 17, 17)
    seen = torch.ones(1, 17, 17, 17, dtype=torch.bool)
    changed = psi.clone()
    changed[..., 8, 8, 8] += 1
    moved = (refinement.coarse(changed, seen)[1] - refinement.coarse(psi, seen)[1])[0].abs() > 0
    distance = (torch.stack(torch.meshgrid(*[torch.arange(17)] * 3, indexing="ij")) - 8).abs()
    assert distance.amax(0)[moved].max() == REACH
    features = (refinement.coarse(changed, seen)[0] - refinement.coarse(psi, seen)[0])[0].abs()
    assert distance.amax(0)[features.sum(0) > 0].max() == REACH - 1


def test_empty_space_around_a_volume_changes_nothing() -> None:
    """Inactive voxels are like the outside: a crop of all active voxels gives the same result."""
    refinement = make(2)
    psi, seen = volume(6, 6, 6)
    padded = nn.functional.pad(psi, (3,) * 6)
    padded_seen = nn.functional.pad(seen, (3,) * 6)
    expected, _ = refinement.coarse(psi, seen)
    found, _ = refinement.coarse(padded, padded_seen)
    torch.testing.assert_close(found[..., 3:9, 3:9, 3:9], expected, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("blocks", [3, 0])
def test_inactive_voxels_stay_zero(blocks: int) -> None:
    refinement = make(blocks)
    psi, seen = volume(4, 4, 4)
    fine_psi, active = volume(12, 12, 12)
    coarse, _ = refinement.coarse(psi, seen)
    fine, _ = refinement.fine(coarse, fine_psi, active)
    assert (coarse.movedim(1, -1)[~seen] == 0).all()
    assert (fine.movedim(1, -1)[~active] == 0).all()
    assert (fine.movedim(1, -1)[active] != 0).any(-1).all()


def test_every_fine_voxel_meets_the_coarse_voxel_around_it() -> None:
    """Without blocks, fine = W [coarse of the voxel / 3, psi] + b, voxel by voxel."""
    refinement = make(0)
    coarse, _ = volume(2, 3, 2, seed=1)
    psi, _ = volume(6, 9, 6, seed=2)
    active = torch.ones(1, 6, 9, 6, dtype=torch.bool)
    fine, _ = refinement.fine(coarse, psi, active)
    weight, bias = refinement.merge.weight[:, :, 0, 0, 0], refinement.merge.bias
    assert bias is not None
    for i, j, k in ((0, 0, 0), (2, 8, 5), (3, 4, 2), (5, 2, 3)):
        both = torch.cat([coarse[0, :, i // 3, j // 3, k // 3], psi[0, :, i, j, k]])
        torch.testing.assert_close(fine[0, :, i, j, k], weight @ both + bias)


def test_without_refinement_voxels_are_on_their_own() -> None:
    refinement = make(0)
    for module in refinement.modules():
        if isinstance(module, nn.Conv3d):
            assert module.kernel_size == (1, 1, 1)
    psi, seen = volume(5, 5, 5)
    features, logits = refinement.coarse(psi, seen)
    assert torch.equal(features, psi)
    changed = psi.clone()
    changed[..., 2, 2, 2] += 1
    moved = (refinement.coarse(changed, seen)[1] - logits)[0].abs() > 0
    assert moved.sum() == 1


def test_channel_norm_by_hand() -> None:
    norm = ChannelNorm(3)
    with torch.no_grad():
        norm.weight.copy_(torch.tensor([1.0, 2.0, 3.0]))
        norm.bias.copy_(torch.tensor([0.0, 0.0, 1.0]))
    x = torch.tensor([1.0, 2.0, 6.0]).view(1, 3, 1, 1, 1)  # mean 3, variance 14 / 3
    deviation = (14 / 3 + 1e-5) ** 0.5
    expected = [-2 / deviation, 2 * -1 / deviation, 3 * 3 / deviation + 1]
    assert norm(x).flatten().tolist() == pytest.approx(expected)


def test_a_block_starts_from_its_input() -> None:
    """Residual: with the last convolution at zero the block changes nothing."""
    torch.manual_seed(0)
    block = ResidualBlock3d(WIDTH)
    torch.nn.init.zeros_(block.conv2.weight)
    assert block.conv2.bias is not None
    torch.nn.init.zeros_(block.conv2.bias)
    psi, seen = volume(3, 3, 3)
    assert torch.equal(block(psi, seen[:, None].float()), psi)
