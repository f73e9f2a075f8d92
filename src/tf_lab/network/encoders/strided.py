"""Convolutions of stride 2 whose maps stay where the images are."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn


class SameConv(nn.Conv2d):
    """A convolution to ceil(size / stride) pixels.

    An output pixel of stride 2 looks at the upper left of the four pixels that it stands for
    (torchvision's padding) or at the lower right (TensorFlow's "SAME"), so that a map of stride s,
    with either throughout, looks (s - 1) / 2 image pixels beside its place. ``lower`` says which.
    Both are the same network on an image shifted by a pixel; taking turns, the shifts nearly
    cancel: a sixth of s is left, to one side and to the other in turn.
    """

    def __init__(
        self, inputs: int, outputs: int, kernel: int, stride: int, lower: bool, groups: int = 1
    ) -> None:
        half = kernel // 2
        shifted = lower and stride == 2
        padding = 0 if shifted else half
        super().__init__(inputs, outputs, kernel, stride, padding, groups=groups, bias=False)
        self.extra = (half - 1, half + 1) * 2 if shifted else None

    def forward(self, x: Tensor) -> Tensor:
        """[N, inputs, h, w] -> [N, outputs, ceil(h / stride), ceil(w / stride)]."""
        return super().forward(x if self.extra is None else F.pad(x, self.extra))


class SamePool(nn.MaxPool2d):
    """3x3 max-pooling of stride 2 of what is not negative, with the same turns."""

    def __init__(self, lower: bool) -> None:
        super().__init__(3, 2, 0 if lower else 1)
        self.lower = lower

    def forward(self, x: Tensor) -> Tensor:
        """[N, C, h, w] -> [N, C, ceil(h / 2), ceil(w / 2)]."""
        return super().forward(F.pad(x, (0, 2, 0, 2)) if self.lower else x)
