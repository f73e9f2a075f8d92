"""What a network is made of; the header of its checkpoint says so."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from tf_lab.errors import TFLabError
from tf_lab.network.fusion import FUSIONS


@dataclass(frozen=True)
class NetworkConfig:
    """Everything that shapes the weights' names and sizes, and nothing else.

    Attributes:
        width: D, the width of tokens, fused and refined features.
        blocks, heads, expansion: of each fusion module.
        hidden: width of the occupancy perceptron.
        refine_blocks: residual blocks a level.
        encoder: arguments of `make_encoder`.
        fusion: the settings of a strategy by name, ``strategy`` among them. Old checkpoints have
            its name alone.
        depth, ray: whether tokens get the projected depth and the viewing ray.
        matching: whether kept tokens get evidence that the views agree; see `Agreement`.
        refine: whether 3D CNNs refine the features.
        filter: whether near-surface masks are trained and used.
        near, far: valid depth range, metres.

    Raises:
        TFLabError: there is no such strategy, or the width is no multiple of the heads.
    """

    width: int
    blocks: int
    heads: int
    expansion: float
    hidden: int
    refine_blocks: int
    encoder: dict[str, Any] = field(default_factory=dict)
    fusion: dict[str, Any] | str = "transformer"
    depth: bool = True
    ray: bool = True
    matching: bool = False
    refine: bool = True
    filter: bool = True
    near: float = 0.3
    far: float = 5.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "fusion", asdict(FUSIONS.settings(self.fusion)))
        if self.width % self.heads:
            raise TFLabError(f"model.width={self.width} must be a multiple of heads={self.heads}")
