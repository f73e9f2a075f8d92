"""TransformerFusion's network: encoder, fusion at two levels, refinement, masks, occupancy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor, nn

from tf_lab.geometry import VoxelGrid, in_view, invert_pose, project
from tf_lab.network.agreement import Agreement
from tf_lab.network.encoders import make_encoder
from tf_lab.network.fusion import make_fusion
from tf_lab.network.fusion.strategy import Fusion
from tf_lab.network.occupancy import OccupancyMLP
from tf_lab.network.refinement import Refinement, upsample
from tf_lab.network.settings import NetworkConfig
from tf_lab.network.tokens import Measurements, Tokens, measure

LEVELS = ("coarse", "fine")


class KeepViews(Protocol):
    """Chooses which of their V views voxels keep in training."""

    needs_logits: bool

    def __call__(
        self, logits: Tensor | None, valid: Tensor, centers: Tensor, keys: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Views int64 [P, K_t], and which of these slots are filled, bool [P, K_t].

        Args:
            logits: [P, V, H] of selection; None if it needs none, or nothing ranks views.
            valid: bool [P, V], which views see the voxel.
            centers: [P, V, 3], the cameras' centres relative to the voxel, metres.
            keys: int64 [P, 3], which voxels they are: chunk of the batch, voxel of it, level.
        """
        ...


@dataclass
class Predictions:
    """What training compares with the ground truth.

    Attributes:
        coarse: near-surface logits [B, X, Y, Z] and ``coarse_seen`` bool, where some view sees.
        fine: near-surface logits [B, 3X', 3Y', 3Z'] and ``fine_active`` bool, where computed.
        occupancy: logits [B, P] and ``seen`` bool, where some view sees the point.
    """

    coarse: Tensor
    coarse_seen: Tensor
    fine: Tensor
    fine_active: Tensor
    occupancy: Tensor
    seen: Tensor


class Network(nn.Module):
    """The whole network. Stateless between calls; view sets live in `tf_lab.online`."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        c = config
        self.config = config
        # channels last: convolutions and samples along the channels are faster, on CPU and GPU
        self.encoder = make_encoder(**c.encoder)
        self.encoder.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        channels = self.encoder.channels
        self.tokens = nn.ModuleDict(
            {name: Tokens(channels[name], c.width, c.depth, c.ray) for name in LEVELS}
        )
        self.fusion = nn.ModuleDict(
            {
                name: make_fusion(c.fusion, c.width, c.blocks, c.heads, c.expansion)
                for name in LEVELS
            }
        )
        self.refinement = Refinement(c.width, c.refine_blocks if c.refine else 0)
        self.occupancy = OccupancyMLP(c.width, c.hidden)
        # last, so that all other weights are drawn as without it
        self.agreement = nn.ModuleDict(
            {name: Agreement(channels[name], c.width) for name in LEVELS if c.matching}
        )

    def compile_parts(self) -> None:
        """Have torch compile what takes most of the time: the encoder and the fusion modules."""
        for part in (self.encoder, *self.fusion.values(), *self.agreement.values()):
            part.compile(dynamic=True)

    def encode(self, images: Tensor) -> dict[str, Tensor]:
        """Images of 0..255 [N, 3, H, W] to feature maps {"coarse", "fine"} [N, C, h, w]."""
        coarse, fine = self.encoder(images)
        return {"coarse": coarse, "fine": fine}

    def embed(self, level: str, measured: Measurements) -> Tensor:
        """Tokens [..., D], each of one measurement alone: what views are selected by."""
        return self.tokens[level](*measured)

    def embed_kept(self, level: str, kept: Measurements) -> Tensor:
        """Tokens [..., K, D] of the measurements that voxels keep, as they are fused."""
        tokens = self.embed(level, kept)
        return tokens + self.agreement[level](kept) if self.config.matching else tokens

    def fuse(self, level: str, tokens: Tensor, slots: Tensor | None) -> tuple[Tensor, Tensor]:
        """Fused features [..., D] and view weights [..., K] of tokens [..., K, D]."""
        return self.fusion[level](tokens, slots)

    def strategy(self, level: str) -> Fusion:
        """The fusion module of a level."""
        strategy = self.fusion[level]
        assert isinstance(strategy, Fusion)
        return strategy

    @property
    def ranks_views(self) -> bool:
        """Whether its fusion says which views it would rather have."""
        return self.strategy("coarse").ranks_views

    def selection_logits(self, level: str, tokens: Tensor) -> Tensor | None:
        """What ranks views with tokens [..., K, D]: [..., K, H]; None: nothing does."""
        strategy = self.strategy(level)
        return strategy.selection_logits(tokens) if strategy.ranks_views else None

    def selection_heads(self, level: str) -> int:
        """H, of `selection_logits`; 0 where there are none."""
        probe = next(self.parameters()).new_zeros(1, self.config.width)
        logits = self.selection_logits(level, probe)
        return 0 if logits is None else logits.shape[-1]

    def forward(
        self,
        images: Tensor,
        K: Tensor,
        world_T_cam: Tensor,
        coarse_grid: VoxelGrid,
        fine_grid: VoxelGrid,
        points: Tensor,
        coarse_target: Tensor | None,
        keep: KeepViews | None = None,
        maps: Mapping[str, Tensor] | None = None,
    ) -> Predictions:
        """One training pass over chunks that share a grid, each in its own frame.

        Args:
            images: [B, V, 3, H, W], 0..255.
            K: [B, V, 3, 3].
            world_T_cam: [B, V, 4, 4], camera to chunk.
            coarse_grid: the chunk's coarse voxels with a margin of whole voxels on all sides.
            fine_grid: the chunk's fine voxels.
            points: [B, P, 3] where occupancy is asked for.
            coarse_target: bool [B, X, Y, Z]; the fine level is computed where it or the predicted
                coarse mask is true, so that it meets in training what it will meet at test time.
            keep: which of its valid views every voxel keeps, as at test time; None: all V views,
                invalid ones too (paper).
            maps: the images' feature maps [B * V, C, h, w] by level, where they are known.
        """
        B, V = images.shape[:2]
        size = (images.shape[-1], images.shape[-2])
        if maps is None:
            maps = self.encode(images.flatten(0, 1))
        depth_range = (self.config.near, self.config.far)

        def fuse(
            level: str, points: Tensor, where: Tensor, voxels: Tensor
        ) -> tuple[Tensor, Tensor]:
            """Fused features of the points [B, P, 3] ``where`` [B, P], and whether a view sees.

            ``voxels`` [B, P] are their numbers in the chunk.
            """
            each = points.unsqueeze(1).expand(-1, V, -1, -1).flatten(0, 1)
            cameras = (K.flatten(0, 1), world_T_cam.flatten(0, 1))
            parts = measure(maps[level], each, *cameras, size, depth_range)
            chosen = (m.unflatten(0, (B, V)).transpose(1, 2)[where] for m in parts)
            measured = Measurements(*chosen)
            centers = (world_T_cam[:, None, :, :3, 3] - points.unsqueeze(2))[where]
            chunk = torch.arange(B, device=K.device)[:, None].expand_as(voxels)
            named = [chunk, voxels, torch.full_like(voxels, LEVELS.index(level))]
            keys = torch.stack(named, dim=-1)[where]
            kept, slots = self.keep_views(level, measured, centers, keys, keep)
            return self.fuse(level, self.embed_kept(level, kept), slots)[0], measured.valid.any(1)

        def seen(where: Tensor) -> Tensor:
            return self.visible(where.unsqueeze(-3), K, world_T_cam, size).any(1)

        centers = coarse_grid.centers().to(K.device).flatten(0, 2).expand(B, -1, -1)
        voxels = torch.arange(centers.shape[1], device=K.device).expand(B, -1)
        fused, some = fuse("coarse", centers, torch.ones_like(voxels, dtype=torch.bool), voxels)
        coarse_seen = some.view(B, *coarse_grid.shape)
        volume = fused.view(B, *coarse_grid.shape, -1) * coarse_seen.unsqueeze(-1)
        coarse, coarse_logits = self.refinement.coarse(volume.permute(0, 4, 1, 2, 3), coarse_seen)

        inner = subgrid(coarse_grid, fine_grid)
        centers = fine_grid.centers().to(K.device).flatten(0, 2)
        active = seen(centers).view(B, *fine_grid.shape)
        near = self._near(coarse_logits, coarse_seen, coarse_target)[(slice(None), *inner)]
        active = active & upsample(near, first_axis=1)
        order, where = _first(active.flatten(1))
        fused, _ = fuse("fine", centers[order], where, order)
        volume = fused.new_zeros(B, *fine_grid.shape, fused.shape[-1])
        volume[active] = fused
        fine, fine_logits = self.refinement.fine(
            coarse[(slice(None), slice(None), *inner)], volume.permute(0, 4, 1, 2, 3), active
        )
        return Predictions(
            coarse_logits,
            coarse_seen,
            fine_logits,
            active,
            self.decode(coarse, coarse_grid, fine, fine_grid, points),
            seen(points),
        )

    def _near(self, logits: Tensor, seen: Tensor, target: Tensor | None) -> Tensor:
        """Coarse voxels whose fine ones are computed: bool [B, X, Y, Z]."""
        if not self.config.filter:
            return seen
        near = logits.detach() > 0
        return seen & (near if target is None else near | target)

    def keep_views(
        self,
        level: str,
        measured: Measurements,
        centers: Tensor,
        keys: Tensor,
        keep: KeepViews | None,
    ) -> tuple[Measurements, Tensor | None]:
        """The measurements that voxels keep in training: what the view store does at test time.

        Args:
            level: "coarse" or "fine".
            measured: of points in views, [P, V, ...].
            centers: [P, V, 3], see `KeepViews`.
            keys: int64 [P, 3], likewise.
            keep: chooses; None keeps everything.

        Returns:
            Measurements [P, K_t, ...] and which slots are filled, bool [P, K_t]; None: all.
        """
        if keep is None:
            return measured, None
        with torch.no_grad():
            logits = None
            if keep.needs_logits:
                logits = self.selection_logits(level, self.embed(level, measured))
            views, slots = keep(logits, measured.valid, centers, keys)
        index = views.unsqueeze(-1)
        kept = Measurements(
            torch.take_along_dim(measured.phi, index, dim=1),
            measured.depth.gather(1, views),
            measured.valid.gather(1, views) & slots,
            torch.take_along_dim(measured.ray, index, dim=1),
        )
        return kept, slots

    def decode(
        self,
        coarse: Tensor,
        coarse_grid: VoxelGrid,
        fine: Tensor,
        fine_grid: VoxelGrid,
        points: Tensor,
    ) -> Tensor:
        """Occupancy logits [..., P] at points [..., P, 3] from volumes [..., D, X, Y, Z]."""
        return self.occupancy(coarse_grid.sample(coarse, points), fine_grid.sample(fine, points))

    def visible(
        self, points: Tensor, K: Tensor, world_T_cam: Tensor, size: tuple[int, int]
    ) -> Tensor:
        """Whether views [..., N] see points [..., 1, P, 3], occlusion apart: bool [..., N, P]."""
        uv, depth = project(points, K, invert_pose(world_T_cam))
        return in_view(uv, depth, size, self.config.near, self.config.far)


def _first(wanted: Tensor) -> tuple[Tensor, Tensor]:
    """Columns [B, P] of a mask [B, N] that hold all that are set, in order, and which of them are.

    P is the largest count of a row.
    """
    order = wanted.int().argsort(dim=1, descending=True, stable=True)[:, : int(wanted.sum(1).max())]
    return order, wanted.gather(1, order)


def subgrid(coarse: VoxelGrid, fine: VoxelGrid) -> tuple[slice, slice, slice]:
    """The coarse voxels that hold the fine grid (aligned to them, 3 to 1), as slices."""
    start = [round((f - c) / coarse.voxel) for c, f in zip(coarse.origin, fine.origin, strict=True)]
    x, y, z = (slice(s, s + n // 3) for s, n in zip(start, fine.shape, strict=True))
    return x, y, z
