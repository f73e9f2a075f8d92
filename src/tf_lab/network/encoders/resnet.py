"""ResNet (He et al. 2016) of basic blocks as a trunk, with a pyramid.

The state-dict keys are torchvision's, so that its ImageNet weights load as they are. The paper's
text does not say which layers give the features; the strides are config values (at the paper's size
1/16 and 1/4).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from tf_lab.errors import TFLabError
from tf_lab.network.encoders.pyramid import Encoder, group_norm
from tf_lab.network.encoders.strided import SameConv, SamePool

IMAGENET_URL = "https://download.pytorch.org/models/resnet18-f37072fd.pth"


def _norm(kind: str, channels: int) -> nn.Module:
    if kind == "batch":
        return nn.BatchNorm2d(channels)
    return group_norm(channels)


class BasicBlock(nn.Module):
    """Two 3x3 convolutions with a residual connection; names as in torchvision."""

    def __init__(self, inputs: int, channels: int, stride: int, norm: str, lower: bool) -> None:
        super().__init__()
        self.conv1 = SameConv(inputs, channels, 3, stride, lower)
        self.bn1 = _norm(norm, channels)
        self.conv2 = nn.Conv2d(channels, channels, 3, 1, 1, bias=False)
        self.bn2 = _norm(norm, channels)
        self.downsample: nn.Module | None = None
        if stride != 1 or inputs != channels:
            self.downsample = nn.Sequential(
                SameConv(inputs, channels, 1, stride, lower), _norm(norm, channels)
            )

    def forward(self, x: Tensor) -> Tensor:
        """[N, inputs, h, w] -> [N, channels, h / stride, w / stride]."""
        identity = x if self.downsample is None else self.downsample(x)
        out = F.relu(self.bn1(self.conv1(x)))
        return F.relu(self.bn2(self.conv2(out)) + identity)


class ResNet(Encoder):
    """ResNet and pyramid.

    Args:
        width: channels of the stem (64 in ResNet-18); doubled at every stage.
        blocks: basic blocks of the four stages ((2, 2, 2, 2) is ResNet-18).
        stem_stride: stride of the first convolution (2 in ResNet-18).
        stem_pool: whether a 3x3 max-pooling of stride 2 follows (True in ResNet-18).
        norm: "batch" (as ImageNet weights need it) or "group" (for small batches).
        centered: whether strides take turns (`SameConv`); False: maps of stride s look
            (s - 1) / 2 image pixels beside their place, as torchvision's.
        maps: strides, channels and length of the maps' features, see `Encoder.build_pyramid`.
    """

    MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # ImageNet's

    def __init__(
        self,
        width: int,
        blocks: Sequence[int],
        stem_stride: int,
        stem_pool: bool,
        norm: str,
        centered: bool = False,
        **maps: Any,
    ) -> None:
        super().__init__()
        turns = cycle((True, False) if centered else (False,))  # of the strides of 2
        self.conv1 = SameConv(3, width, 7, stem_stride, stem_stride == 2 and next(turns))
        self.bn1 = _norm(norm, width)
        self.pool = SamePool(next(turns)) if stem_pool else nn.Identity()
        stride = stem_stride * (2 if stem_pool else 1)
        self.strides: list[int] = []
        channels = [width]
        for i, count in enumerate(blocks):
            step = 1 if i == 0 else 2
            stride *= step
            self.strides.append(stride)
            inner, lower = width * 2**i, step == 2 and next(turns)
            layers = [BasicBlock(channels[-1], inner, step, norm, lower)]
            layers += [BasicBlock(inner, inner, 1, norm, lower) for _ in range(count - 1)]
            channels.append(inner)
            self.add_module(f"layer{i + 1}", nn.Sequential(*layers))
        self.build_pyramid(self.strides, channels[1:], **maps)

    def stages(self, x: Tensor) -> list[Tensor]:
        """Of normalised images [N, 3, H, W]: the output of every stage."""
        x = self.pool(F.relu(self.bn1(self.conv1(x))))
        found = []
        for i in range(len(self.strides)):
            x = getattr(self, f"layer{i + 1}")(x)
            found.append(x)
        return found

    def trunk_of(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """A state dict without the classifier."""
        return {key: value for key, value in state.items() if not key.startswith("fc.")}

    @classmethod
    def published_weights(cls) -> dict[str, Tensor]:
        """ResNet-18 weights of torchvision from torch's hub cache, else downloaded and verified."""
        try:
            return torch.hub.load_state_dict_from_url(
                IMAGENET_URL, map_location="cpu", check_hash=True, weights_only=True
            )
        except Exception as error:  # of the network, of the disk, or of what a damaged file holds
            path = Path(torch.hub.get_dir(), "checkpoints", IMAGENET_URL.rsplit("/", 1)[1])
            raise TFLabError(
                f"encoder.weights=imagenet: {IMAGENET_URL} cannot be had ({error}); put the file "
                f"at {path}, or use encoder.weights=none"
            ) from error
