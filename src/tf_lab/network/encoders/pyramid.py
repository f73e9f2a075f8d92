"""What encoders share: a trunk of stages, and the light top-down pyramid that makes their maps."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from tf_lab.errors import TFLabError

# begin the names of the pyramid's tensors
PYRAMID = ("lateral.", "entry.", "mixing.", "coarse_head.", "fine_head.")


def group_norm(channels: int) -> nn.GroupNorm:
    """Of groups of 8 channels."""
    return nn.GroupNorm(max(1, channels // 8), channels)


class Mixing(nn.Module):
    """A separable 3x3 convolution beside the identity, which it is at first."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.filter = nn.Conv2d(channels, channels, 3, padding=1, groups=channels, bias=False)
        self.norm = group_norm(channels)
        self.mix = nn.Conv2d(channels, channels, 1)
        for parameter in self.mix.parameters():
            nn.init.zeros_(parameter)

    def forward(self, x: Tensor) -> Tensor:
        """[N, channels, h, w] to the same."""
        return x + self.mix(F.relu(self.norm(self.filter(x))))


class Encoder(nn.Module):
    """Images to coarse and fine feature maps: a trunk, and a feature pyramid (Lin et al. 2017).

    A kind of encoder is a subclass: it builds its trunk, calls `build_pyramid`, and gives `stages`.
    The trunk's state-dict keys are those of the weights it takes from elsewhere.

    Attributes:
        MEAN, STD: of RGB in 0..1, which normalised images have subtracted and divided by.
        PUBLISHED: what ``encoder.weights`` calls the weights that others made for the trunk.
        channels: of the maps {"coarse", "fine"}.
        stride: of the same, image pixels a pixel.
    """

    MEAN: ClassVar[tuple[float, float, float]]
    STD: ClassVar[tuple[float, float, float]]
    PUBLISHED: ClassVar[str] = "imagenet"
    channels: dict[str, int]
    stride: dict[str, int]
    mean: Tensor
    std: Tensor

    def __init__(self) -> None:
        super().__init__()
        for name, value in (("mean", self.MEAN), ("std", self.STD)):
            self.register_buffer(name, torch.tensor(value).view(3, 1, 1), persistent=False)

    @abstractmethod
    def stages(self, x: Tensor) -> list[Tensor]:
        """The trunk's maps of normalised images [N, 3, H, W], from the finest to the coarsest."""

    @abstractmethod
    def trunk_of(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """A state dict without the layers that the trunk has no use for, such as a classifier."""

    @classmethod
    @abstractmethod
    def published_weights(cls) -> dict[str, Tensor]:
        """The state dict that others published. Raises TFLabError: it cannot be had."""

    def build_pyramid(
        self,
        strides: Sequence[int],
        trunk_channels: Sequence[int],
        coarse_stride: int,
        fine_stride: int,
        coarse_channels: int,
        fine_channels: int,
        unit_norm: bool,
        pyramid_channels: int | None = None,
        mixed: bool = False,
    ) -> None:
        """Add the pyramid's layers.

        Args:
            strides: of the trunk's stages.
            trunk_channels: of the same.
            coarse_stride: of the coarse map; must be one that a stage has.
            fine_stride: of the fine map; the same.
            coarse_channels: of the coarse map.
            fine_channels: of the fine map.
            unit_norm: scale every feature vector to length sqrt(channels).
            pyramid_channels: inside the pyramid; None: those of the wider map.
            mixed: for a trunk that is not trained with it: stages are normalised where they enter
                (they differ in scale), upsampled bilinearly, and mixed by a separable convolution
                at every level (Tan et al. 2020); without, the pyramid is linear.

        Raises:
            TFLabError: no stage has such a stride.
        """
        for name, wanted in (("coarse_stride", coarse_stride), ("fine_stride", fine_stride)):
            if wanted not in strides:
                raise TFLabError(f"encoder.{name}={wanted}: the stages have {list(strides)}")
        # of stages of one stride the last, which knows most
        self.coarse_level = max(i for i, s in enumerate(strides) if s == coarse_stride)
        self.fine_level = max(i for i, s in enumerate(strides) if s == fine_stride)
        if self.fine_level > self.coarse_level:
            raise TFLabError("encoder.fine_stride must not exceed encoder.coarse_stride")
        self.unit_norm = unit_norm
        self.channels = {"coarse": coarse_channels, "fine": fine_channels}
        self.stride = {"coarse": coarse_stride, "fine": fine_stride}
        width = pyramid_channels or max(fine_channels, coarse_channels)
        self.lateral = nn.ModuleList(
            nn.Conv2d(c, width, 1) for c in trunk_channels[self.fine_level :]
        )
        self.upsampling = "bilinear" if mixed else "nearest"
        self.entry = nn.ModuleList(
            group_norm(width) if mixed else nn.Identity() for _ in self.lateral
        )
        self.mixing = nn.ModuleList(Mixing(width) if mixed else nn.Identity() for _ in self.lateral)
        self.coarse_head = nn.Conv2d(width, coarse_channels, 3, padding=1)
        self.fine_head = nn.Conv2d(width, fine_channels, 3, padding=1)

    def pyramid_parameters(self) -> Iterator[nn.Parameter]:
        """Those that are not the trunk's."""
        return (p for name, p in self.named_parameters() if name.startswith(PYRAMID))

    def trunk_parameters(self) -> Iterator[nn.Parameter]:
        """Those that weights from elsewhere initialise."""
        return (p for name, p in self.named_parameters() if not name.startswith(PYRAMID))

    def normalise(self, images: Tensor) -> Tensor:
        """uint8 or float RGB in 0..255 [N, 3, H, W] to what the trunk's weights expect."""
        return (images.float() / 255 - self.mean) / self.std

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """RGB in 0..255 [N, 3, H, W] -> coarse [N, Cc, h, w] and fine [N, Cf, h', w'] maps."""
        x = self.normalise(images).contiguous(memory_format=torch.channels_last)
        stages = self.stages(x)
        top: Tensor | None = None
        coarse = fine = x
        for level in reversed(range(self.fine_level, len(stages))):
            i = level - self.fine_level
            side = self.entry[i](self.lateral[i](stages[level]))
            if top is not None:
                # Onto an odd side a bilinear map is stretched, up to half of its stride. Placing it
                # exactly changed no matching score by more than 0.005, trained so or not.
                side = side + F.interpolate(top, size=side.shape[-2:], mode=self.upsampling)
            top = self.mixing[i](side)
            if level == self.coarse_level:
                coarse = self.coarse_head(top)
            if level == self.fine_level:
                fine = self.fine_head(top)
        if self.unit_norm:
            coarse = F.normalize(coarse, dim=1) * coarse.shape[1] ** 0.5
            fine = F.normalize(fine, dim=1) * fine.shape[1] ** 0.5
        return coarse, fine


class FixedStatistics(Encoder):
    """An encoder whose batch normalisation keeps its statistics, in training too."""

    def train(self, mode: bool = True) -> Self:
        """Trunk and pyramid, but for the batch normalisation."""
        super().train(mode)
        for module in self.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
        return self
