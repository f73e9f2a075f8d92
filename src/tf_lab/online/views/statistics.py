"""What the view sets of a reconstruction are worth, given the true depth of its frames."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from tf_lab.geometry import in_view, project
from tf_lab.online.lattice.level import Level

BATCH = 1 << 14  # voxels at a time


@dataclass(frozen=True)
class ViewSets:
    """Means over voxels that hold views; 0 where there are none.

    Attributes:
        voxels: how many.
        views: held by a voxel.
        visible: share of the held views that truly see the voxel.
        visible_of_all: the same of all views whose frustum holds it.
        spread: angle between two held viewing directions, degrees.
        variety: different views held in the 3x3x3 neighbourhood.
    """

    voxels: int
    views: float
    visible: float
    visible_of_all: float
    spread: float
    variety: float


@torch.inference_mode()
def view_sets(level: Level, rows: Tensor, depths: Iterable[Tensor]) -> ViewSets:
    """Measure the view sets of some voxels, which should be near the true surface.

    Args:
        level: of a reconstruction.
        rows: int64 [M], voxels; those without views are left out.
        depths: true camera z [H, W] in metres of every frame in the order they were added, 0 where
            unknown: such views count neither as seeing nor as hidden.
    """
    rows = rows[level.store.filled[rows].any(1)]
    held, filled = level.store.frames[rows].long(), level.store.filled[rows]
    sees, known = _sight(level, rows, depths)
    held_known = filled & known.gather(1, held.clamp(min=0))
    held_sees = held_known & sees.gather(1, held.clamp(min=0))
    return ViewSets(
        voxels=len(rows),
        views=_mean(filled.sum(1)),
        visible=_share(held_sees, held_known),
        visible_of_all=_share(sees, known),
        spread=_spread(level, rows, held, filled),
        variety=_mean(_variety(level, rows)),
    )


def _mean(values: Tensor) -> float:
    return float(values.sum()) / max(1, len(values))


def _share(part: Tensor, whole: Tensor) -> float:
    return float(part.sum()) / max(1.0, float(whole.sum()))


def _sight(level: Level, rows: Tensor, depths: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
    """Which frames truly see rows, and of which that is known: bool [M, frames]."""
    points, cameras, size = level.points(rows), level.frames.cameras, level.frames.size
    config = level.network.config
    sees, known = [], []
    for frame, depth in enumerate(depths):
        uv, z = project(points, cameras["K"][frame], cameras["cam_T_world"][frame])
        inside = in_view(uv, z, size, config.near, config.far)
        column, row = uv.round().long().unbind(-1)
        index = row.clamp(0, size[1] - 1) * size[0] + column.clamp(0, size[0] - 1)
        there = depth.to(z).flatten()[index]
        known.append(inside & (there > 0))
        sees.append(known[-1] & (z <= there + level.voxel))
    return torch.stack(sees, 1), torch.stack(known, 1)


def _spread(level: Level, rows: Tensor, held: Tensor, filled: Tensor) -> float:
    """Mean angle (degrees) between the directions of two held views, over pairs and voxels."""
    centers = level.frames.cameras["world_T_cam"][:, :3, 3][held.clamp(min=0)]
    direction = F.normalize(centers - level.points(rows)[:, None], dim=-1)
    angle = torch.acos((direction @ direction.transpose(1, 2)).clamp(-1, 1))
    pairs = (filled[:, :, None] & filled[:, None]).triu(1)
    count = pairs.sum((1, 2))
    mean = (angle * pairs).sum((1, 2))[count > 0] / count[count > 0]
    return math.degrees(_mean(mean))


def _variety(level: Level, rows: Tensor) -> Tensor:
    """How many different frames are held around each of rows [M]: int64 [M]."""
    steps = torch.cartesian_prod(*[torch.arange(-1, 2, device=rows.device)] * 3)
    found = []
    for part in rows.split(BATCH):
        around = level.blocks.row_of(level.blocks.voxels(part)[:, None] + steps)  # [M, 27]
        frames = level.store.frames[around.clamp(min=0)]
        frames = frames.masked_fill((around < 0).unsqueeze(-1), -1).flatten(1).sort(1).values
        new = F.pad(frames[:, 1:] != frames[:, :-1], (1, 0), value=True)
        found.append((new & (frames >= 0)).sum(1))
    return torch.cat(found)
