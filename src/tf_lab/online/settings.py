"""Settings of a reconstruction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tf_lab.errors import TFLabError
from tf_lab.geometry import FINE
from tf_lab.online.views import POLICIES

PRECISIONS = ("float32", "float16", "bfloat16")


def cells_per_voxel(voxel: float, resolution: float) -> int:
    """How many marching-cubes cells of edge ``resolution`` lie along a voxel's edge (metres).

    Raises:
        TFLabError: not a whole number.
    """
    n = round(voxel / resolution) if resolution > 0 else 0
    if n < 1 or abs(n * resolution - voxel) > 1e-6:
        raise TFLabError(
            f"resolution={resolution}: the fine voxel of {voxel} m must be a multiple of it"
        )
    return n


@dataclass(frozen=True)
class ReconstructionSettings:
    """All that shapes a reconstruction, given a network.

    Attributes:
        views: K, measurements kept a voxel (16 in the paper).
        select: which these are: settings of a policy (or its name) of `tf_lab.online.views`. A
            network whose fusion does not rank views keeps random ones, if a policy needs a ranking.
        seed: of what is random in that.
        keyframe_distance: of a capture's frames those are used that are so far from the one before,
            see `tf_lab.data.keyframes`; 0 takes every frame.
        threshold: of both near-surface masks (0.5 in the paper).
        resolution: edge of the marching-cubes cells, metres (0.02 in the paper).
        batch: voxels fused at a time, which bounds the memory.
        precision: in which the networks compute: "float32", "float16", "bfloat16" or "auto".
        logits: in which selection logits are kept; see `tf_lab.online.views.store`.
        maps: in which feature maps are kept, as ``precision``.
        maps_device: where they are kept ("cpu" beside a GPU); None: where the network is.
        maps_budget: bytes they may take; what has no room is encoded again when needed. None: all
            are kept.

    Raises:
        TFLabError: a value that cannot be.
    """

    views: int = 16
    select: Any = "attention"
    seed: int = 0
    keyframe_distance: float = 0.1
    threshold: float = 0.5
    resolution: float = 0.02
    batch: int = 8192
    precision: str = "float32"
    logits: str = "float16"
    maps: str = "float32"
    maps_device: str | None = None
    maps_budget: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "select", POLICIES.settings(self.select))
        if self.views < 1:
            raise TFLabError(f"views={self.views}: a voxel needs at least one view")
        if self.batch < 1:
            raise TFLabError(f"batch={self.batch}: at least one voxel is fused at a time")
        cells_per_voxel(FINE, self.resolution)  # told now, not after the training
        if self.maps_budget is not None and self.maps_budget <= 0:
            raise TFLabError("maps_budget: must be more than 0, or null to keep all maps")
        for name, others in (("precision", ["auto"]), ("logits", []), ("maps", ["auto"])):
            if getattr(self, name) not in (*PRECISIONS, *others):
                choices = ", ".join([*PRECISIONS, *others])
                raise TFLabError(f"{name}={getattr(self, name)}: choose one of {choices}")
