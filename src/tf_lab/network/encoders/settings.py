"""Settings of the encoders."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from tf_lab.errors import TFLabError
from tf_lab.support.settings import setting


@dataclass(frozen=True, kw_only=True)
class EncoderSettings:
    """What all kinds have: where weights come from, and the maps, whose size the model sets."""

    name: str = setting(about="the kind of encoder", shapes="weights")
    weights: str = setting(
        "imagenet",
        "to start from: imagenet, rooms (pre-trained), shipped (our checkpoint's), none, or a file",
        shapes="weights",
        kind="source",
    )
    coarse_stride: int = setting(
        about="image pixels a pixel of the coarse map; a stride that a stage has",
        shapes="weights",
        least=1,
    )
    fine_stride: int = setting(about="of the fine map", shapes="weights", least=1)
    coarse_channels: int = setting(about="of the coarse map", shapes="weights", least=1, most=8192)
    fine_channels: int = setting(about="of the fine map", shapes="weights", least=1, most=8192)
    unit_norm: bool = setting(about="features scaled to length sqrt(channels)", shapes="weights")

    def architecture(self) -> dict[str, Any]:
        """All but what the weights start from: what `make_encoder` takes."""
        names = [field.name for field in fields(self) if field.name != "weights"]
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True, kw_only=True)
class ResNetSettings(EncoderSettings):
    """ResNet (He et al. 2016), as in the paper."""

    name: str = setting("resnet", "the kind of encoder", shapes="weights")
    width: int = setting(
        64, "channels of the stem, doubled at every stage", shapes="weights", least=1, most=1024
    )
    blocks: list[int] = setting([2, 2, 2, 2], "a stage", shapes="weights", least=1, most=100)
    stem_stride: int = setting(2, "of the first convolution", shapes="weights", least=1, most=2)
    stem_pool: bool = setting(True, "max-pooling of stride 2 after it", shapes="weights")
    norm: str = setting(
        "batch",
        "batch (as ImageNet's weights need it) or group (for small batches)",
        shapes="weights",
    )
    centered: bool = setting(
        True,
        "maps look at their own place, to a sixth of their stride; false: beside it by half of it",
        shapes="weights",
        absent=False,
    )

    def __post_init__(self) -> None:
        if self.norm not in ("batch", "group"):
            raise TFLabError(f"encoder.norm={self.norm}: choose batch or group")


@dataclass(frozen=True, kw_only=True)
class MixedPyramidSettings(EncoderSettings):
    """Those whose pyramid makes maps of a trunk that was trained for something else."""

    pyramid_channels: int = setting(
        64, "channels inside the pyramid", shapes="weights", least=1, most=8192
    )


@dataclass(frozen=True, kw_only=True)
class EfficientNetLite0Settings(MixedPyramidSettings):
    """EfficientNet-Lite0 (Tan and Le 2019), which knows photographs."""

    name: str = setting("efficientnet_lite0", "the kind of encoder", shapes="weights")
    top_stride: int = setting(16, "where the trunk ends: 16 or 32", shapes="weights")

    def __post_init__(self) -> None:
        if self.top_stride not in (16, 32):
            raise TFLabError(f"encoder.top_stride={self.top_stride}: choose 16 or 32")


@dataclass(frozen=True, kw_only=True)
class XFeatSettings(MixedPyramidSettings):
    """XFeat (Potje et al. 2024), which matches photographs."""

    name: str = setting("xfeat", "the kind of encoder", shapes="weights")
    weights: str = setting(
        "xfeat",
        "to start from: xfeat, rooms (pre-trained), shipped (our checkpoint's), none, or a file",
        shapes="weights",
        kind="source",
    )
