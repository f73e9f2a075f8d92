"""Where a point is to what its view's own depth map shows (``inputs=stereo``): ours.

A transformer that compares features at a point cannot know that they match better elsewhere along
the ray, before the surface or behind it. Stereo looks along the ray, and says where. FineRecon
(Stier et al. 2023) guides its volume by fused depth; here each token gets that of its own view, so
that fusion weighs the views, and selection keeps those that truly see the point.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from tf_lab.network.tokens import Measurements

# metres behind the point, and over how much each counts
OFFSETS = (-1.0, -0.5, -0.25, -0.12, -0.06, 0.0, 0.06, 0.12, 0.25, 0.5, 1.0)
SPREADS = (0.4, 0.25, 0.15, 0.07, 0.06, 0.06, 0.06, 0.07, 0.15, 0.25, 0.4)


class StereoEvidence(nn.Module):
    """A linear map, zero at first, of the depth along the view's ray relative to the point.

    What it is told of a view: how near that depth is to each of `OFFSETS` behind (or before) the
    point, as Gaussians, once plain and once times the stereo's score; whether there is a depth, and
    the score. All are zero without one.

    Args:
        width: D, of the tokens.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.linear = nn.Linear(2 * len(OFFSETS) + 2, width, bias=False)
        nn.init.zeros_(self.linear.weight)
        for name, values in (("offsets", OFFSETS), ("spreads", SPREADS)):
            self.register_buffer(name, torch.tensor(values), persistent=False)

    offsets: Tensor
    spreads: Tensor

    def forward(self, measured: Measurements) -> Tensor:
        """What to add to tokens [..., D]; zero for invalid ones."""
        return self.linear(self.evidence(measured))

    def evidence(self, measured: Measurements) -> Tensor:
        """The numbers themselves [..., E], float32."""
        with torch.autocast(measured.depth.device.type, enabled=False):  # bfloat16 has 3 digits
            depth, score = measured.stereo.float().unsqueeze(-2).unbind(-1)
            behind = (depth - measured.depth.float().unsqueeze(-1)).clamp(-1, 1)
            near = torch.exp(-0.5 * ((behind - self.offsets) / self.spreads).square())
            known = measured.valid.unsqueeze(-1) & (depth > 0)
            told = [near, near * score, torch.ones_like(score), score]
            return torch.cat(told, dim=-1) * known
