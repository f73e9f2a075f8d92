"""Settings of a reconstruction."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from tf_lab.errors import TFLabError
from tf_lab.geometry import FINE
from tf_lab.online.mesher import cells_per_voxel

DTYPES = {
    "float32": torch.float32,
    "float16": torch.float16,
    "bfloat16": torch.bfloat16,
}


def dtype_of(precision: str, device: torch.device) -> torch.dtype:
    """The dtype called so; "auto": bfloat16 on a GPU, else float32."""
    if precision == "auto":
        precision = "bfloat16" if device.type == "cuda" else "float32"
    return DTYPES[precision]


@dataclass(frozen=True)
class ReconstructionSettings:
    """Test-time settings.

    Attributes:
        views: K, measurements kept a voxel (16 in the paper).
        threshold: of both near-surface masks (0.5 in the paper).
        resolution: edge of the marching-cubes cells, metres (0.02 in the paper).
        batch: voxels fused at a time, which bounds the memory.
        precision: in which the networks compute: "float32", "float16", "bfloat16" or "auto".
        logits: in which selection logits are kept; see `view_store`.
        maps: in which feature maps are kept, as ``precision``.
        maps_device: where they are kept ("cpu" beside a GPU); None: where the network is.
        maps_budget: bytes they may take; what has no room is encoded again when needed. None: all
            are kept.
    """

    views: int = 16
    threshold: float = 0.5
    resolution: float = 0.02
    batch: int = 8192
    precision: str = "float32"
    logits: str = "float16"
    maps: str = "float32"
    maps_device: str | None = None
    maps_budget: int | None = None

    def __post_init__(self) -> None:
        if self.views < 1:
            raise TFLabError(f"views={self.views}: a voxel needs at least one view")
        if self.batch < 1:
            raise TFLabError(f"batch={self.batch}: at least one voxel is fused at a time")
        cells_per_voxel(FINE, self.resolution)  # told now, not after the training
        if self.maps_budget is not None and self.maps_budget <= 0:
            raise TFLabError("maps_budget: must be more than 0, or null to keep all maps")
        for name, others in (("precision", ["auto"]), ("logits", []), ("maps", ["auto"])):
            if getattr(self, name) not in (*DTYPES, *others):
                choices = ", ".join([*DTYPES, *others])
                raise TFLabError(f"{name}={getattr(self, name)}: choose one of {choices}")
