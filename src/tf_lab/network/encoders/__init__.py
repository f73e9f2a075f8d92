"""Encoders: one file a kind, all with one signature, images to coarse and fine feature maps.

To add one, subclass `Encoder` in a file of its own, write its settings, and register both here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tf_lab.network.encoders.settings import (
    EfficientNetLite0Settings,
    ResNetSettings,
    XFeatSettings,
)
from tf_lab.support.registry import Part, Registry

if TYPE_CHECKING:
    from tf_lab.network.encoders.pyramid import Encoder

ENCODERS: Registry[Part] = Registry("encoder", "name")
ENCODERS.add(
    Part("resnet", "tf_lab.network.encoders.resnet:ResNet", ResNetSettings, option="resnet18")
)
ENCODERS.add(
    Part(
        "efficientnet_lite0",
        "tf_lab.network.encoders.efficientnet:EfficientNetLite0",
        EfficientNetLite0Settings,
    )
)
ENCODERS.add(Part("xfeat", "tf_lab.network.encoders.xfeat:XFeat", XFeatSettings))


def make_encoder(name: str = "resnet", **arguments: Any) -> Encoder:
    """The encoder called so (checkpoints older than the others name none), with random weights.

    Raises:
        TFLabError: there is none of this name.
    """
    return ENCODERS[name].load()(**arguments)
