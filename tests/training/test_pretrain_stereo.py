"""The loss of what reads depth from stereo's scores: against its definition, pixel by pixel."""

import math
from typing import Any

import pytest
import torch

from tf_lab.data.plane_sweeps import SweepBatch
from tf_lab.stereo.depth import StereoSettings
from tf_lab.stereo.regularizer import Regularizer
from tf_lab.training.pretrain_stereo import DISTANCE_WEIGHT, WITHIN, DepthTraining, depth_loss

FEW = StereoSettings(planes=8)


def by_hand(logits: torch.Tensor, depth: torch.Tensor) -> float:
    """Pixel by pixel."""
    inverse, terms = FEW.inverse, []
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            z = float(depth[y, x])
            if not FEW.near < z < FEW.far:
                continue
            likely = logits[:, y, x].softmax(0).tolist()
            upper = next(i for i, value in enumerate(inverse) if value >= 1 / z)
            share = (1 / z - inverse[upper - 1]) / (inverse[upper] - inverse[upper - 1])
            entropy = -(1 - share) * math.log(likely[upper - 1]) - share * math.log(likely[upper])
            mean = sum(p * math.log(1 / value) for p, value in zip(likely, inverse, strict=True))
            terms.append(entropy + DISTANCE_WEIGHT * abs(mean - math.log(z)))
    return sum(terms) / len(terms)


def test_it_is_cross_entropy_and_distance_where_depth_is_known() -> None:
    torch.manual_seed(0)
    logits, depth = torch.randn(8, 3, 4), 0.45 + 4.5 * torch.rand(3, 4)
    depth[0] = torch.tensor([0.0, 0.2, 7.0, 1.0])  # unknown, too near, too far
    found = depth_loss(logits[None], depth[None], FEW)
    assert found.item() == pytest.approx(by_hand(logits, depth), rel=1e-4)


def test_where_nothing_is_known_there_is_nothing_to_learn() -> None:
    logits = torch.randn(1, 8, 3, 4, requires_grad=True)
    loss = depth_loss(logits, torch.zeros(1, 3, 4), FEW)
    loss.backward()
    assert logits.grad is not None
    assert loss.item() == 0 and (logits.grad == 0).all()


def test_one_batch_can_be_learnt_by_heart() -> None:
    """Scores of pure noise and a wall that slants: what it says approaches the truth."""
    torch.manual_seed(0)
    wall = torch.linspace(1.0, 2.0, 16).expand(1, 12, 16)
    batch = SweepBatch(torch.rand(1, 8, 12, 16), wall)
    module = DepthTraining(Regularizer(), FEW, 3e-3, 60, ["val"])
    adam = torch.optim.Adam(module.parameters(), 3e-3)
    losses = []
    for _ in range(60):
        loss = depth_loss(module.regularizer(batch.scores), batch.depth, FEW)
        adam.zero_grad()
        loss.backward()
        adam.step()
        losses.append(loss.item())
    assert losses[-1] < 0.4 * losses[0]


class Sure(torch.nn.Module):
    """Says the plane of the highest score, without doubt."""

    def forward(self, scores: torch.Tensor) -> torch.Tensor:
        return 200 * scores


def test_scores_are_shares_of_the_known_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of errors of 0, 3, 7, 15 and 40 cm, and of a pixel beyond the planes."""
    settings = StereoSettings(planes=64)
    inverse = torch.from_numpy(settings.inverse).float()
    planes = torch.full((6,), 20)
    truth = 1 / inverse[planes] + torch.tensor([0.0, 0.03, -0.07, 0.15, 0.4, 50.0])
    scores = torch.nn.functional.one_hot(planes, 64).T.reshape(1, 64, 1, 6).float()
    module = DepthTraining(Regularizer(), settings, 1e-3, 1, ["val"])
    module.regularizer = Sure()  # type: ignore[assignment]
    logged: dict[str, torch.Tensor] = {}
    monkeypatch.setattr(module, "log_dict", lambda values, **_: logged.update(values))
    module.validation_step(SweepBatch(scores, truth.view(1, 1, 6)), 0)
    assert WITHIN == {"5cm": 0.05, "10cm": 0.1}
    assert logged["val/within_5cm"] == pytest.approx(2 / 5)
    assert logged["val/within_10cm"] == pytest.approx(3 / 5)
    assert logged["val/raw_within_5cm"] == pytest.approx(2 / 5)
    assert logged["val/median"] == pytest.approx(0.07, abs=1e-4)
    assert logged["val/confidence"] == pytest.approx(1, abs=1e-4)


def test_the_rate_warms_up_and_falls_to_zero() -> None:
    module = DepthTraining(Regularizer(), FEW, 2e-3, 400, ["val"])
    found: Any = module.configure_optimizers()
    optimizer, schedule = found["optimizer"], found["lr_scheduler"]["scheduler"]
    rates = []
    for _ in range(401):
        rates.append(optimizer.param_groups[0]["lr"])
        optimizer.step()
        schedule.step()
    assert rates[0] == pytest.approx(2e-3 / 50, rel=1e-3)
    assert rates[100] == pytest.approx(2e-3 * (1 + math.cos(math.pi / 4)) / 2)
    assert rates[200] == pytest.approx(1e-3)
    assert rates[400] == pytest.approx(0, abs=1e-9)


def test_a_frame_without_depth_counts_for_no_score(monkeypatch: pytest.MonkeyPatch) -> None:
    module = DepthTraining(Regularizer(), FEW, 1e-3, 1, ["val"])
    logged: list[dict[str, torch.Tensor]] = []
    monkeypatch.setattr(module, "log_dict", lambda values, **_: logged.append(values))
    scores = torch.rand(1, 8, 12, 16)
    module.validation_step(SweepBatch(scores, torch.zeros(1, 12, 16)), 0)
    assert not logged
    module.validation_step(SweepBatch(scores, torch.ones(1, 12, 16)), 1)
    assert logged[0] and all(torch.isfinite(value) for value in logged[0].values())
