"""Learning to read depth from the scores of a plane sweep."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import lightning as L
import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor

from tf_lab.data.plane_sweeps import SweepBatch
from tf_lab.stereo.depth import StereoSettings
from tf_lab.stereo.regularizer import Regularizer, read_depth
from tf_lab.training.schedule import scheduled, warm_cosine

DISTANCE_WEIGHT = 2.0  # of the error of the mean logarithm beside the cross-entropy
WITHIN = {"5cm": 0.05, "10cm": 0.1}


def depth_loss(logits: Tensor, depth: Tensor, settings: StereoSettings) -> Tensor:
    """Cross-entropy with the true depth's two planes, and the error of the mean log depth.

    Args:
        logits: [B, P, h, w] of the planes.
        depth: [B, h, w] metres; where it is unknown, or beyond the planes, nothing counts.
        settings: which planes.
    """
    inverse = torch.from_numpy(settings.inverse).to(logits)
    known = (depth > settings.near) & (depth < settings.far)
    depth = depth.clamp(settings.near, settings.far)
    place = (1 / depth - inverse[0]) / (inverse[1] - inverse[0])
    below = place.floor().clamp(0, settings.planes - 2)
    share, below = (place - below).unsqueeze(1), below.long().unsqueeze(1)
    likely = logits.log_softmax(dim=1)
    entropy = -(likely.gather(1, below) * (1 - share) + likely.gather(1, below + 1) * share)
    mean = torch.einsum("bphw,p->bhw", likely.exp(), -inverse.log())
    error = (mean - depth.log()).abs()
    total = (entropy.squeeze(1) + DISTANCE_WEIGHT * error) * known
    return total.sum() / known.sum().clamp(min=1)


class DepthTraining(L.LightningModule):
    """Trains a regularizer; validates how much of the depth it gives is right.

    Args:
        regularizer: trained in place.
        settings: of the sweeps.
        lr: peak learning rate.
        steps: in all.
        sets: names of what is validated on, one a loader.
    """

    def __init__(
        self,
        regularizer: Regularizer,
        settings: StereoSettings,
        lr: float,
        steps: int,
        sets: Sequence[str],
    ) -> None:
        super().__init__()
        self.regularizer, self.settings = regularizer, settings
        self.lr, self.steps, self.sets = lr, steps, sets

    def training_step(self, batch: SweepBatch, batch_idx: int) -> Tensor:
        """The loss of a batch."""
        logits = self.regularizer(batch.scores)
        with torch.autocast(self.device.type, enabled=False):  # bfloat16 has 3 digits
            loss = depth_loss(logits.float(), batch.depth, self.settings)
        self.log("train/loss", loss.detach())
        return loss

    def validation_step(self, batch: SweepBatch, batch_idx: int, dataloader_idx: int = 0) -> None:
        """Shares of the true depths between the planes that are met.

        ``raw`` is what the best plane says without the network.
        """
        scores, truth, settings = batch.scores, batch.depth, self.settings
        inverse = torch.from_numpy(settings.inverse).to(scores)
        logits = self.regularizer(scores).float()
        with torch.autocast(self.device.type, enabled=False):
            depth, confidence = read_depth(logits, inverse)
            loss = depth_loss(logits, truth, settings)
        known = (truth > settings.near) & (truth < settings.far)
        if not known.any():
            return
        error = (depth - truth).abs()[known]
        raw = (1 / inverse[scores.argmax(1)] - truth).abs()[known]
        terms = {f"within_{name}": (error < most).float().mean() for name, most in WITHIN.items()}
        terms["raw_within_5cm"] = (raw < WITHIN["5cm"]).float().mean()
        terms["median"] = error.median()
        terms["confidence"] = confidence[known].mean()
        terms["loss"] = loss
        named = {f"{self.sets[dataloader_idx]}/{k}": v for k, v in terms.items()}
        self.log_dict(named, batch_size=1, add_dataloader_idx=False)

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """AdamW, short warm-up, cosine to zero."""
        adam = torch.optim.AdamW(self.regularizer.parameters(), self.lr, weight_decay=1e-2)
        return scheduled(adam, partial(warm_cosine, steps=self.steps))
