"""What a view's depth map says of a point: by its definition, and what must not change it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from helpers.toy_views import toy
from tf_lab.network.stereo_evidence import OFFSETS, SPREADS, StereoEvidence
from tf_lab.network.tokens import Measurements
from tf_lab.training.losses import losses

D = 10


def told(depth: float, score: float, point: float, valid: bool = True) -> np.ndarray:
    """The evidence of one view."""
    empty = torch.zeros(1, 0)
    stereo = torch.tensor([[depth, score]])
    one = (empty, torch.tensor([point]), torch.tensor([valid]), torch.zeros(1, 3), stereo)
    return StereoEvidence(D).evidence(Measurements(*one))[0].numpy()


@pytest.mark.parametrize("behind", [-0.7, -0.05, 0.0, 0.3])
def test_evidence_is_how_near_the_surface_is_to_each_offset(behind: float) -> None:
    z = (behind - np.array(OFFSETS)) / np.array(SPREADS)
    near = np.exp(-(z**2) / 2)
    expected = [*near, *(0.6 * near), 1.0, 0.6]
    np.testing.assert_allclose(told(2.0 + behind, 0.6, 2.0), expected, atol=1e-5)


def test_a_metre_away_is_away() -> None:
    np.testing.assert_array_equal(told(4.9, 0.6, 2.0), told(3.1, 0.6, 2.0))


def test_nothing_is_said_without_depth_or_view() -> None:
    assert (told(0.0, 0.0, 2.0) == 0).all()
    assert (told(2.0, 0.6, 2.0, valid=False) == 0).all()


def test_an_untrained_map_adds_nothing() -> None:
    views = Measurements(
        torch.zeros(5, 0), torch.rand(5), torch.ones(5) > 0, torch.zeros(5, 3), torch.rand(5, 2)
    )
    assert (StereoEvidence(D)(views) == 0).all()


def depths(views: Tensor) -> Tensor:
    """Depth maps [B, V, 2, 12, 16] of images [B, V, 3, 24, 32]: the chunk's middle is at 1.2 m."""
    generator = torch.Generator().manual_seed(3)
    return 0.5 + torch.rand(*views.shape[:2], 2, 12, 16, generator=generator)


def test_training_reads_all_of_it(tiny_network: Callable[..., Any]) -> None:
    """Gradients reach every number, at both levels."""
    network, given = tiny_network(stereo=True), toy()
    views = given["views"]
    given["views"] = type(views)(**{**vars(views), "stereo": depths(views.images)})
    out = network(**given)
    sdf = torch.linspace(-0.1, 0.1, 80).view(2, 40)
    fine = torch.rand(2, 15, 15, 15) < 0.3
    losses(out, given["coarse_target"], fine, sdf, use_masks=True, sdf_weight=0.0)[
        "loss"
    ].backward()
    for module in network.stereo_evidence.values():
        assert (module.linear.weight.grad.abs().amax(0) > 0).all()


def test_selection_looks_at_it(tiny_network: Callable[..., Any]) -> None:
    """A view that looks past the point is told apart by its logits, whatever other views say."""
    network = tiny_network(stereo=True)
    torch.nn.init.normal_(network.stereo_evidence["fine"].linear.weight)
    channels = network.config.encoder["fine_channels"]
    phi, ray = torch.zeros(1, 2, channels), torch.zeros(1, 2, 3)
    there = (phi, torch.full((1, 2), 2.0), torch.ones(1, 2) > 0, ray)
    hit = Measurements(*there, torch.tensor([[[2.0, 0.9], [2.0, 0.9]]]))
    mixed = Measurements(*there, torch.tensor([[[2.0, 0.9], [1.2, 0.9]]]))
    same = network.selection_logits("fine", network.embed("fine", hit))
    other = network.selection_logits("fine", network.embed("fine", mixed))
    assert torch.equal(other[:, 0], same[:, 0])
    assert (other[:, 1] - same[:, 1]).abs().max() > 0.01
