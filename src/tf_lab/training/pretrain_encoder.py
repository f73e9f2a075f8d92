"""Dense contrastive matching: corresponding pixels get like features (InfoNCE, 2018)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import lightning as L
import torch
import torch.nn.functional as F
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn

from tf_lab.data.pairs import PairBatch
from tf_lab.geometry import covered_pixels, sample_maps
from tf_lab.network.encoders.pyramid import Encoder
from tf_lab.training.schedule import scheduled, warm_cosine

APART = 1.5  # candidates nearer to the truth than this many strides are not wrong enough


def matching_loss(
    maps: Tensor,
    uv_a: Tensor,
    uv_b: Tensor,
    size: tuple[int, int],
    stride: int,
    temperature: float,
) -> tuple[Tensor, Tensor]:
    """Find each point of the first image among all points and epipolar candidates of the second.

    Args:
        maps: [B, 2, C, h, w] feature maps of image pairs.
        uv_a: [B, P, 2] pixels in the first images.
        uv_b: [B, P, 1 + E, 2] pixels in the second: the true one, then wrong ones.
        size: (width, height) of the images, pixels.
        stride: of the maps.
        temperature: of the softmax over cosine similarities.

    Returns:
        The loss, and the share of points whose most similar candidate is the true one.
    """
    B, P, n = uv_b.shape[:3]
    covered = covered_pixels(maps, stride)
    a = F.normalize(sample_maps(maps[:, 0], uv_a, covered), dim=-1)
    b = F.normalize(sample_maps(maps[:, 1], uv_b.flatten(1, 2), covered), dim=-1)
    b = b.unflatten(1, (P, n))
    others = torch.einsum("bpc,bqc->bpq", a, b[:, :, 0])
    along = torch.einsum("bpc,bpec->bpe", a, b[:, :, 1:])
    true = uv_b[:, :, 0]
    close = torch.cdist(true, true) < APART * stride
    close &= ~torch.eye(P, dtype=torch.bool, device=close.device)
    close_along = (uv_b[:, :, 1:] - true[:, :, None]).norm(dim=-1) < APART * stride
    outside = ((uv_b[:, :, 1:] < -0.5) | (uv_b[:, :, 1:] > uv_b.new_tensor(size) - 0.5)).any(-1)
    logits = torch.cat(
        [
            others.masked_fill(close, -torch.inf),
            along.masked_fill(close_along | outside, -torch.inf),
        ],
        dim=-1,
    )
    target = torch.arange(P, device=maps.device).expand(B, P)
    loss = F.cross_entropy((logits / temperature).flatten(0, 1), target.flatten())
    return loss, (logits.argmax(-1) == target).float().mean()


class Matching(L.LightningModule):
    """Trains an encoder so that both its maps tell corresponding pixels from others.

    Args:
        encoder: trained in place.
        lr: peak learning rate of the pyramid.
        trunk_factor: the trunk's over it; 0: the trunk stays as it is.
        steps: in all.
        temperature: of the softmax over candidates.
        sets: names of what is validated on, one a loader.
    """

    def __init__(
        self,
        encoder: Encoder,
        lr: float,
        trunk_factor: float,
        steps: int,
        temperature: float,
        sets: Sequence[str],
    ) -> None:
        super().__init__()
        self.encoder, self.lr, self.steps = encoder, lr, steps
        self.trunk_factor, self.temperature, self.sets = trunk_factor, temperature, sets
        for parameter in encoder.trunk_parameters():
            parameter.requires_grad_(trunk_factor > 0)
        if trunk_factor == 0:  # nor do its batch statistics change; Lightning keeps these modes
            for part in encoder.modules():
                if isinstance(part, nn.BatchNorm2d):
                    part.eval()

    def _losses(self, batch: PairBatch) -> dict[str, Tensor]:
        size = (batch.images.shape[-1], batch.images.shape[-2])
        maps = self.encoder(batch.images.flatten(0, 1))
        terms: dict[str, Tensor] = {}
        with torch.autocast(self.device.type, enabled=False):  # the best of many needs digits
            for name, level in zip(("coarse", "fine"), maps, strict=True):
                pairs = level.float().unflatten(0, (-1, 2))
                terms[name], terms[f"{name}_top1"] = matching_loss(
                    pairs, batch.uv_a, batch.uv_b, size, self.encoder.stride[name], self.temperature
                )
        terms["loss"] = terms["coarse"] + terms["fine"]
        return terms

    def training_step(self, batch: PairBatch, batch_idx: int) -> dict[str, Tensor]:
        """InfoNCE at both levels."""
        terms = self._losses(batch)
        seen = {k: v.detach() for k, v in terms.items()}
        self.log_dict({f"train/{k}": v for k, v in seen.items()})
        return {**seen, "loss": terms["loss"]}

    def validation_step(self, batch: PairBatch, batch_idx: int, dataloader_idx: int = 0) -> None:
        """The same on scenes never trained on; the best match of P + E candidates."""
        terms = {f"{self.sets[dataloader_idx]}/{k}": v for k, v in self._losses(batch).items()}
        self.log_dict(terms, batch_size=1, add_dataloader_idx=False)

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Adam, short warm-up, cosine to zero."""
        trunk = [p for p in self.encoder.trunk_parameters() if p.requires_grad]
        groups: list[dict[str, Any]] = [{"params": list(self.encoder.pyramid_parameters())}]
        groups += [{"params": trunk, "lr": self.lr * self.trunk_factor}] if trunk else []
        adam = torch.optim.Adam(groups, self.lr)
        return scheduled(adam, partial(warm_cosine, steps=self.steps))
