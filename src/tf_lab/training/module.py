"""The LightningModule of training: losses, optimiser, schedule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor

from tf_lab.config.groups import OptimizerSettings
from tf_lab.data.chunks import COARSE_GRID, FINE_GRID, ChunkBatch
from tf_lab.network.chunks import Views
from tf_lab.network.network import Network
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.online.views import make_policy
from tf_lab.online.views.batch import BatchSelection
from tf_lab.training.evaluation import SceneEvaluation
from tf_lab.training.known_maps import KnownMaps
from tf_lab.training.losses import losses, mean_over_processes
from tf_lab.training.schedule import learning_rate_factor, scheduled


class Training(SceneEvaluation):
    """Trains a network on chunks; validates it on whole scenes.

    Args:
        network: what is trained.
        optimizer: see `OptimizerSettings`.
        sdf_weight: of the signed-distance loss (0 in the paper).
        test: test-time settings of validation.
        maps_memory: bytes of feature maps to keep if the encoder is frozen.
        metrics: settings of metrics of validation beyond the paper's.
    """

    def __init__(
        self,
        network: Network,
        optimizer: OptimizerSettings,
        sdf_weight: float,
        test: ReconstructionSettings,
        maps_memory: int = 0,
        metrics: Sequence[Any] = (),
    ) -> None:
        super().__init__(network, test, metrics)
        if not network.config.filter:  # L = L_o: nothing teaches the heads; DDP wants to know
            for head in (network.refinement.coarse_mask, network.refinement.fine_mask):
                head.requires_grad_(False)
        self.optimizer_settings, self.sdf_weight = optimizer, sdf_weight
        frozen = optimizer.encoder_factor == 0
        self.known_maps = KnownMaps(network, maps_memory) if frozen else None
        self.save_hyperparameters(
            {
                "network": asdict(network.config),
                "optimizer": asdict(optimizer),
                "sdf_weight": sdf_weight,
            }
        )

    def training_step(self, batch: ChunkBatch, batch_idx: int) -> dict[str, Tensor]:
        """L = L_c + L_f + L_o of a batch."""
        known = self.known_maps
        maps = None if known is None else known(batch.images.flatten(0, 1))
        views = Views(batch.images, batch.K, batch.world_T_cam, batch.times, maps, batch.stereo)
        predictions = self.network(
            views, COARSE_GRID, FINE_GRID, batch.points, batch.coarse_target, kept_by(batch)
        )
        terms = losses(
            predictions,
            batch.coarse_target,
            batch.fine_target,
            batch.sdf,
            use_masks=self.network.config.filter,
            sdf_weight=self.sdf_weight,
        )
        seen = mean_over_processes({k: v.detach() for k, v in terms.items()})
        self.log_dict({f"train/{k}": v for k, v in seen.items()}, batch_size=len(batch.images))
        return {**seen, "loss": terms["loss"]}

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Adam with a per-step schedule."""
        s = self.optimizer_settings
        encoder = [p for p in self.network.encoder.parameters() if p.requires_grad]
        others = [p for n, p in self.network.named_parameters() if not n.startswith("encoder.")]
        groups: list[dict[str, Any]] = [
            {"params": others},
            {"params": encoder, "lr": s.lr * s.encoder_factor},
        ]
        adam = torch.optim.Adam(groups, s.lr, s.betas, s.eps, s.weight_decay)
        return scheduled(adam, partial(learning_rate_factor, s))


def kept_by(batch: ChunkBatch) -> BatchSelection | None:
    """What chooses the views that voxels keep in a step; None: they keep all."""
    if not batch.keep:
        return None
    return BatchSelection(make_policy(batch.rule, 0), batch.keep, batch.draws)
