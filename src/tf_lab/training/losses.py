"""L = L_c + L_f + L_o (paper, Sec. 3), and an optional signed-distance term (ours).

Every term is a mean over the voxels or points of the whole batch. In distributed training each
process divides by the mean of all processes' counts, so that the average of their gradients is
the gradient of one process with all their chunks.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
import torch.distributed as dist
import torch.nn.functional as F
from torch import Tensor

from tf_lab.network.chunks import Predictions

NEAR_WEIGHT = 2.0  # of near-surface voxels in L_c and L_f (paper, Sec. 3.5)
SDF_SCALE, SDF_CLIP = 0.03, 3.0  # metres per unit of logit, largest target


def mask_loss(logits: Tensor, target: Tensor, where: Tensor) -> Tensor:
    """BCE of near-surface masks, near-surface voxels weighing double, over voxels ``where``.

    Args:
        logits: [B, X, Y, Z].
        target: bool [B, X, Y, Z].
        where: bool [B, X, Y, Z]; 0 is returned if none is set.
    """
    logits, target = _of(where, logits, target)
    truth = target.float()
    loss = F.binary_cross_entropy_with_logits(
        logits, truth, weight=1 + (NEAR_WEIGHT - 1) * truth, reduction="sum"
    )
    return loss / _count(where)


def occupancy_loss(logits: Tensor, occupied: Tensor, where: Tensor) -> Tensor:
    """BCE of occupancy [B, P] over the points ``where``; 0 if there are none."""
    logits, occupied = _of(where, logits, occupied)
    loss = F.binary_cross_entropy_with_logits(logits, occupied.float(), reduction="sum")
    return loss / _count(where)


def sdf_loss(logits: Tensor, sdf: Tensor, where: Tensor) -> Tensor:
    """Smooth L1 between occupancy logits and the scaled, clipped negative signed distance.

    Not in the paper: it tells the perceptron how far the surface is, which BCE alone does not.

    Args:
        logits: [B, P].
        sdf: [B, P] in metres, positive in free space.
        where: bool [B, P].
    """
    logits, sdf = _of(where, logits, sdf)
    target = (-sdf / SDF_SCALE).clamp(-SDF_CLIP, SDF_CLIP)
    loss = F.smooth_l1_loss(logits, target, reduction="sum")
    return loss / _count(where)


def losses(
    predictions: Predictions,
    coarse_target: Tensor,
    fine_target: Tensor,
    sdf: Tensor,
    use_masks: bool,
    sdf_weight: float,
) -> dict[str, Tensor]:
    """All terms and their weighted sum "loss".

    Args:
        predictions: of the network.
        coarse_target: bool [B, X, Y, Z], the true coarse near-surface mask.
        fine_target: bool [B, X, Y, Z], the true fine near-surface mask.
        sdf: [B, P] in metres, positive in front of the surface, NaN where unknown.
        use_masks: False for ``filter=false``: L = L_o.
        sdf_weight: of the signed-distance term; 0 in the paper.
    """
    p = predictions
    where = p.seen & ~torch.isnan(sdf)
    terms = {"occupancy": occupancy_loss(p.occupancy, sdf < 0, where)}
    total = terms["occupancy"]
    if use_masks:
        terms["coarse"] = mask_loss(p.coarse, coarse_target, p.coarse_seen)
        terms["fine"] = mask_loss(p.fine, fine_target, p.fine_active)
        total = total + terms["coarse"] + terms["fine"]
    if sdf_weight > 0:
        terms["sdf"] = sdf_loss(p.occupancy, sdf, where)
        total = total + sdf_weight * terms["sdf"]
    terms["loss"] = total
    return terms


def _of(where: Tensor, *values: Tensor) -> list[Tensor]:
    """Values of one shape where a mask is set; a GPU is waited for but once."""
    rows = where.flatten().nonzero().squeeze(1)
    return [value.flatten()[rows] for value in values]


def mean_over_processes(values: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Numbers averaged over the processes of a distributed training, by one call for all."""
    found = torch.stack([*values.values()])
    if dist.is_available() and dist.is_initialized():
        dist.all_reduce(found)
        found = found / dist.get_world_size()
    return dict(zip(values, found.unbind(), strict=True))


def _count(where: Tensor) -> Tensor:
    """How many are set, at least one; the mean over all processes of a distributed training."""
    total, processes = where.sum(dtype=torch.float32), 1
    if dist.is_available() and dist.is_initialized():
        dist.all_reduce(total)
        processes = dist.get_world_size()
    return total.clamp(min=1) / processes
