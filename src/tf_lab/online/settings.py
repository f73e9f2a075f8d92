"""Settings of a reconstruction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tf_lab.errors import TFLabError
from tf_lab.geometry import FINE
from tf_lab.online.views import POLICIES
from tf_lab.support.memory import check_memory
from tf_lab.support.settings import MOST_SEED, check_ranges, setting

ROOM = 50_000  # voxels of a small one
VIEW_BYTES = 12  # a view in a voxel, with 4 heads
CELL_BYTES = 4
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
class InferenceSettings:
    """How a network reconstructs; nothing here, and in select and online, trains another one."""

    views: int = setting(16, "K, measurements kept a voxel", shapes="scores", least=1)
    resolution: float = setting(0.02, "metres, marching cubes", shapes="scores", above=0)
    threshold: float = setting(0.5, "of the near-surface masks", shapes="scores", least=0, most=1)
    keyframe_distance: float = setting(
        0.1, "DeepVideoMVS' combined pose distance; 0: every frame", shapes="scores", least=0
    )


@dataclass(frozen=True)
class ReconstructionSettings(InferenceSettings):
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
        maps_budget: bytes they may take; what has no room is encoded again when needed. None: half
            of the memory that is free when the first frame comes.

    Raises:
        TFLabError: a value that cannot be.
    """

    select: Any = "attention"
    seed: int = setting(0, least=0, most=MOST_SEED)
    batch: int = setting(8192, least=1)
    precision: str = "float32"
    logits: str = "float16"
    maps: str = "float32"
    maps_device: str | None = None
    maps_budget: int | None = setting(None, least=1)

    def __post_init__(self) -> None:
        object.__setattr__(self, "select", POLICIES.settings(self.select))
        check_ranges(self)
        cells = cells_per_voxel(FINE, self.resolution) ** 3  # told now, not after the training
        check_memory(
            f"views={self.views}: a room", ROOM * VIEW_BYTES * self.views, "give fewer views"
        )
        check_memory(
            f"resolution={self.resolution:g}: the mesh of a room",
            ROOM * CELL_BYTES * cells,
            "give a coarser resolution",
        )
        for name, others in (("precision", ["auto"]), ("logits", []), ("maps", ["auto"])):
            if getattr(self, name) not in (*PRECISIONS, *others):
                choices = ", ".join([*PRECISIONS, *others])
                raise TFLabError(f"online.{name}={getattr(self, name)}: choose one of {choices}")
