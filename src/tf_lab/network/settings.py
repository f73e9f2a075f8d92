"""What a network is made of; the header of its checkpoint says so."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from tf_lab.errors import TFLabError
from tf_lab.network.encoders import ENCODERS
from tf_lab.network.fusion import FUSIONS
from tf_lab.support.settings import absent_values, check_given, check_ranges, setting

MOST_FAR = 50  # metres; a frustum that long holds a million coarse voxels


@dataclass(frozen=True, kw_only=True)
class NetworkSizes:
    """The sizes that all networks have (paper, Sec. 3)."""

    width: int = setting(
        about="D, of tokens, fused and refined features", shapes="weights", least=1, most=8192
    )
    blocks: int = setting(about="transformer blocks a level", shapes="weights", least=1, most=256)
    heads: int = setting(about="of attention", shapes="weights", least=1, most=8192)
    expansion: float = setting(
        about="width of the feed-forward modules over D", shapes="weights", above=0, most=64
    )
    hidden: int = setting(
        about="width of the occupancy perceptron", shapes="weights", least=1, most=65536
    )
    refine_blocks: int = setting(
        about="residual 3D-conv blocks a level", shapes="weights", least=0, most=256
    )


@dataclass(frozen=True, kw_only=True)
class NetworkConfig(NetworkSizes):
    """Everything that shapes the weights' names and sizes, and nothing else.

    Attributes:
        encoder: arguments of `make_encoder`.
        fusion: the settings of a strategy by name, ``strategy`` among them. Old checkpoints have
            its name alone.
        depth, ray: whether tokens get the projected depth and the viewing ray.
        matching: whether kept tokens get evidence that the views agree; see `Agreement`.
        stereo: whether tokens get what the view's own depth map says; see `StereoEvidence`.
        refine: whether 3D CNNs refine the features.
        filter: whether near-surface masks are trained and used.
        near, far: valid depth range, metres.

    Raises:
        TFLabError: there is no such strategy, a size is out of its range, or the width is no
            multiple of the heads.
    """

    encoder: dict[str, Any] = field(default_factory=dict)
    fusion: dict[str, Any] | str = "transformer"
    depth: bool = True
    ray: bool = True
    matching: bool = False
    stereo: bool = setting(False, absent=False)
    refine: bool = True
    filter: bool = True
    near: float = setting(0.3, least=0)
    far: float = setting(5.0, above=0, most=MOST_FAR)

    def __post_init__(self) -> None:
        object.__setattr__(self, "fusion", asdict(FUSIONS.settings(self.fusion)))
        check_ranges(self, "model.")
        kind = ENCODERS[self.encoder.get("name", "resnet")].settings
        object.__setattr__(self, "encoder", {**absent_values(kind), **self.encoder})
        check_given(kind, self.encoder, "encoder.")
        if self.width % self.heads:
            raise TFLabError(f"model.width={self.width} must be a multiple of heads={self.heads}")
