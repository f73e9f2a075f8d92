"""Evidence that a voxel's kept views agree (``inputs=matching``): ours, the paper has none.

Near a surface the views that truly see it have like features; in front of it, behind it and where a
view is hidden they differ. A transformer would have to find that out by comparing tokens; here it
is told, as plane-sweep stereo is by its cost volume.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from tf_lab.network.tokens import Measurements

GROUPS = 8  # of channels, correlated apart (group-wise correlation, Guo et al. 2019)
PAIRWISE = 5  # numbers a view that come from the cosines to the others
NARROW = 20  # a direction 18 degrees off weighs 1 / e of the same one
FEW = 4  # other views at which half of all certainty is reached


class Agreement(nn.Module):
    """A linear map, zero at first, of how each view's feature compares with the others' kept.

    What it is told of a view, in cosines of its feature to those of the other valid views: the
    greatest, the mean, the mean over the nearest viewing directions, the mean weighted by how far
    the directions are apart, how many the others are; the mean correlation by group of channels;
    and of all kept views together, the variance of each channel. All are zero for a view without
    others, and but for the greatest and the count none grows or shrinks with K.

    Args:
        features: channels C of the feature map.
        width: D, of the tokens.
    """

    def __init__(self, features: int, width: int) -> None:
        super().__init__()
        self.groups = math.gcd(features, GROUPS)
        self.linear = nn.Linear(PAIRWISE + self.groups + features, width, bias=False)
        nn.init.zeros_(self.linear.weight)

    def forward(self, views: Measurements) -> Tensor:
        """What to add to the tokens of kept views [..., K]: [..., K, D]; zero for invalid ones."""
        return self.linear(self.evidence(views))

    def evidence(self, views: Measurements) -> Tensor:
        """The numbers themselves [..., K, E], float32."""
        with torch.autocast(views.phi.device.type, enabled=False):  # bfloat16 has 3 digits
            valid = views.valid.unsqueeze(-1)
            unit = F.normalize(views.phi.float() * valid, dim=-1)
            count = valid.sum(-2, keepdim=True)
            total = unit.sum(-2, keepdim=True)
            mean = (total - unit) / (count - 1).clamp(min=1)  # of the others
            by_group = (unit * mean).unflatten(-1, (self.groups, -1)).sum(-1) * self.groups
            variance = _variance(unit, valid, total, count) * unit.shape[-1]
            told = [_pairwise(unit, views), by_group, variance.expand_as(unit)]
            return torch.cat(told, dim=-1) * (valid & (count > 1))


def _pairwise(unit: Tensor, views: Measurements) -> Tensor:
    """From the cosines of unit features [..., K, C] to each other: [..., K, 5]."""
    cosine = unit @ unit.transpose(-1, -2)
    ray = views.ray.float()
    towards = ray @ ray.transpose(-1, -2)  # cosines of the angles between viewing directions
    itself = torch.eye(cosine.shape[-1], dtype=torch.bool, device=cosine.device)
    other = views.valid.unsqueeze(-2) & ~itself
    beside = torch.softmax((NARROW * towards).masked_fill(~other, -1e4), dim=-1)
    apart = (1 - towards).clamp(min=1e-4) * other
    count = other.sum(-1)
    return torch.stack(
        [
            cosine.masked_fill(~other, -1).amax(-1),
            (cosine * other).sum(-1) / count.clamp(min=1),
            (cosine * beside).sum(-1),
            (cosine * apart).sum(-1) / apart.sum(-1).clamp(min=1e-4),
            count / (count + FEW),
        ],
        dim=-1,
    )


def _variance(unit: Tensor, valid: Tensor, total: Tensor, count: Tensor) -> Tensor:
    """Unbiased variance over the valid ones of [..., K, C]: [..., 1, C]."""
    deviation = (unit - total / count.clamp(min=1)) * valid
    return deviation.square().sum(-2, keepdim=True) / (count - 1).clamp(min=1)
