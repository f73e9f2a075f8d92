"""The loss terms against hand-computed numbers."""

import math
from dataclasses import replace

import pytest
import torch
import torch.distributed as dist
from torch import Tensor

from tf_lab.network.chunks import Predictions
from tf_lab.training.losses import (
    losses,
    mask_loss,
    mean_over_processes,
    occupancy_loss,
    sdf_loss,
)

NAN = float("nan")
# cross entropy of a logit: log(1 + exp(-x)) if true, log(1 + exp(x)) if false
LOG3 = math.log(3.0)


def bce(logit: float, truth: bool) -> float:
    return math.log1p(math.exp(-logit if truth else logit))


def line(*values: float | bool) -> Tensor:
    """[1, 1, 1, n]."""
    return torch.tensor(values).view(1, 1, 1, -1)


def predictions() -> Predictions:
    return Predictions(
        coarse=line(LOG3, -LOG3, 5.0),
        coarse_seen=line(True, True, False),
        fine=line(0.0, 2.0, -1.0, 0.5),
        fine_active=line(True, False, True, True),
        occupancy=torch.tensor([[LOG3, -1.0, 0.7, 9.0, 2.0]]),
        seen=torch.tensor([[True, True, True, False, True]]),
    )


COARSE = line(True, False, True)
FINE = line(True, True, False, True)
SDF = torch.tensor([[-0.02, 0.05, NAN, 0.01, 0.0]])
# Points 0, 1 and 4 count: the third isn't known and the fourth isn't seen. A point on the surface
# (sdf = 0) isn't behind it.
OCCUPANCY = (bce(LOG3, True) + bce(-1.0, False) + bce(2.0, False)) / 3
# log(4 / 3) both for sigmoid = 3/4 at a true voxel, weighing 2, and 1/4 at a false one
COARSE_LOSS = (2 * math.log(4 / 3) + math.log(4 / 3)) / 2
FINE_LOSS = (2 * bce(0.0, True) + bce(-1.0, False) + 2 * bce(0.5, True)) / 3


def test_near_surface_voxels_weigh_double() -> None:
    p = predictions()
    assert mask_loss(p.coarse, COARSE, p.coarse_seen).item() == pytest.approx(COARSE_LOSS)
    assert mask_loss(p.fine, FINE, p.fine_active).item() == pytest.approx(FINE_LOSS)
    everywhere = torch.ones_like(COARSE)
    near = mask_loss(line(0.3, 0.3), line(True, True), everywhere[..., :2]).item()
    assert near == pytest.approx(2 * bce(0.3, True))


def test_total_is_the_sum() -> None:
    terms = losses(predictions(), COARSE, FINE, SDF, use_masks=True, sdf_weight=0.0)
    assert set(terms) == {"occupancy", "coarse", "fine", "loss"}
    assert terms["occupancy"].item() == pytest.approx(OCCUPANCY)
    assert terms["coarse"].item() == pytest.approx(COARSE_LOSS)
    assert terms["fine"].item() == pytest.approx(FINE_LOSS)
    assert terms["loss"].item() == pytest.approx(OCCUPANCY + COARSE_LOSS + FINE_LOSS)


def test_without_filter_only_occupancy_counts() -> None:
    terms = losses(predictions(), COARSE, FINE, SDF, use_masks=False, sdf_weight=0.0)
    assert set(terms) == {"occupancy", "loss"}
    assert terms["loss"].item() == pytest.approx(OCCUPANCY)


def test_signed_distance_term() -> None:
    """Targets -sdf / 3 cm: 2/3, -5/3, 0; smooth L1 is e^2 / 2 below 1 and e - 1/2 above."""
    p = predictions()
    errors = (abs(LOG3 - 2 / 3), abs(-1 + 5 / 3), abs(2 - 0))
    expected = (errors[0] ** 2 / 2 + errors[1] ** 2 / 2 + errors[2] - 0.5) / 3
    terms = losses(p, COARSE, FINE, SDF, use_masks=True, sdf_weight=0.5)
    assert terms["sdf"].item() == pytest.approx(expected)
    assert terms["loss"].item() == pytest.approx(
        OCCUPANCY + COARSE_LOSS + FINE_LOSS + 0.5 * expected
    )


def test_far_from_the_surface_the_distance_is_clipped() -> None:
    where = torch.ones(1, 2, dtype=torch.bool)
    far = sdf_loss(torch.tensor([[3.0, -3.0]]), torch.tensor([[-1.0, 2.0]]), where)
    assert far.item() == 0


def test_unseen_and_unknown_give_no_gradient() -> None:
    p = predictions()
    leaves = {n: getattr(p, n).clone().requires_grad_() for n in ("coarse", "fine", "occupancy")}
    losses(replace(p, **leaves), COARSE, FINE, SDF, True, 0.5)["loss"].backward()
    occupancy, coarse, fine = (leaves[n].grad for n in ("occupancy", "coarse", "fine"))
    assert occupancy is not None
    assert coarse is not None
    assert fine is not None
    assert (occupancy != 0).tolist() == [[True, True, False, False, True]]
    assert ((coarse != 0) == p.coarse_seen).all()
    assert ((fine != 0) == p.fine_active).all()
    assert torch.isfinite(occupancy).all()


def test_nothing_to_supervise() -> None:
    none = torch.zeros(1, 1, 1, 3, dtype=torch.bool)
    logits = line(1.0, 2.0, 3.0).requires_grad_()
    for loss in (
        mask_loss(logits, COARSE, none),
        occupancy_loss(logits[0, 0], COARSE[0, 0], none[0, 0]),
        sdf_loss(logits[0, 0], torch.full((1, 3), NAN), none[0, 0]),
    ):
        assert loss.item() == 0
        loss.backward()  # a step of training goes on


def test_the_mean_over_two_processes_is_the_loss_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """However the supervised voxels and points are shared out: here 1 and 2, or 2 and 1."""
    p = predictions()
    terms = (
        (mask_loss, p.coarse, COARSE, line(True, True, True)),
        (mask_loss, p.fine, FINE, p.fine_active),
        (occupancy_loss, p.occupancy, SDF < 0, p.seen & ~SDF.isnan()),
        (sdf_loss, p.occupancy, SDF, p.seen & ~SDF.isnan()),
    )
    for loss, logits, target, where in terms:
        expected, total = loss(logits, target, where).item(), int(where.sum())
        parts = [x.tensor_split([2], dim=-1) for x in (logits, target, where)]
        with monkeypatch.context() as two_processes:
            two_processes.setattr(dist, "is_initialized", lambda: True)
            two_processes.setattr(dist, "get_world_size", lambda: 2)
            two_processes.setattr(dist, "all_reduce", lambda count, n=total: count.fill_(n))
            halves = [loss(*part).item() for part in zip(*parts, strict=True)]
        assert sum(halves) / 2 == pytest.approx(expected)
        assert halves[0] != pytest.approx(halves[1])


def test_what_is_logged_is_the_mean_over_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    ours = {"loss": torch.tensor(3.0), "sdf": torch.tensor(1.0)}
    assert mean_over_processes(ours) == ours
    monkeypatch.setattr(dist, "is_initialized", lambda: True)
    monkeypatch.setattr(dist, "get_world_size", lambda: 2)
    monkeypatch.setattr(dist, "all_reduce", lambda found: found.add_(torch.tensor([5.0, 0.0])))
    assert mean_over_processes(ours) == {"loss": torch.tensor(4.0), "sdf": torch.tensor(0.5)}
    assert ours["loss"] == 3
