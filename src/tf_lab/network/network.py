"""TransformerFusion's network: encoder, fusion at two levels, refinement, masks, occupancy."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from tf_lab.geometry import VoxelGrid, covered_pixels, in_view, invert_pose, project, sample_maps
from tf_lab.network.agreement import Agreement
from tf_lab.network.chunks import KeepViews, Predictions, Views
from tf_lab.network.encoders import make_encoder
from tf_lab.network.fusion import make_fusion
from tf_lab.network.fusion.strategy import Fusion, check_outputs
from tf_lab.network.occupancy import OccupancyMLP
from tf_lab.network.refinement import Refinement, upsample
from tf_lab.network.settings import NetworkConfig
from tf_lab.network.stereo_evidence import StereoEvidence
from tf_lab.network.tokens import Measurements, Tokens, measure

LEVELS = ("coarse", "fine")


class Network(nn.Module):
    """The whole network. Stateless between calls; view sets live in `tf_lab.online`."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        c = config
        self.config = config
        # channels last: convolutions and samples along the channels are faster, on CPU and GPU
        self.encoder = make_encoder(**c.encoder)
        self.encoder.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        channels, self.stride = self.encoder.channels, self.encoder.stride
        self.tokens = nn.ModuleDict(
            {name: Tokens(channels[name], c.width, c.depth, c.ray) for name in LEVELS}
        )
        self.fusion = nn.ModuleDict(
            {
                name: make_fusion(c.fusion, c.width, c.blocks, c.heads, c.expansion)
                for name in LEVELS
            }
        )
        check_outputs(self.strategy("coarse"), c.width)
        self.refinement = Refinement(c.width, c.refine_blocks if c.refine else 0)
        self.occupancy = OccupancyMLP(c.width, c.hidden)
        # last, so that all other weights are drawn as without it
        self.agreement = nn.ModuleDict(
            {name: Agreement(channels[name], c.width) for name in LEVELS if c.matching}
        )
        self.stereo_evidence = nn.ModuleDict(
            {name: StereoEvidence(c.width) for name in LEVELS if c.stereo}
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
        tokens = self.tokens[level](measured)
        return tokens + self.stereo_evidence[level](measured) if self.config.stereo else tokens

    def embed_kept(self, level: str, kept: Measurements) -> Tensor:
        """Tokens [..., K, D] of the measurements that voxels keep, as they are fused."""
        tokens = self.embed(level, kept)
        return tokens + self.agreement[level](kept) if self.config.matching else tokens

    def fuse(
        self, level: str, tokens: Tensor, slots: Tensor | None, times: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Fused features [..., D] and view weights [..., K] of tokens [..., K, D].

        Args:
            level: "coarse" or "fine".
            tokens: of the views in some order.
            slots: bool [..., K], which of them are filled; None: all.
            times: int [..., K], numbers that grow with time, by which a strategy that reads views
                in order gets them; None: they are in order.
        """
        strategy = self.strategy(level)
        if times is None or not strategy.ordered:
            return strategy(tokens, slots)
        if slots is not None:
            times = times.masked_fill(~slots, torch.iinfo(times.dtype).max)
        order = times.argsort(dim=-1, stable=True)
        tokens = torch.take_along_dim(tokens, order.unsqueeze(-1), dim=-2)
        fused, weights = strategy(tokens, None if slots is None else slots.gather(-1, order))
        return fused, torch.zeros_like(weights).scatter(-1, order, weights)

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
        views: Views,
        coarse_grid: VoxelGrid,
        fine_grid: VoxelGrid,
        points: Tensor,
        coarse_target: Tensor | None,
        keep: KeepViews | None = None,
    ) -> Predictions:
        """One training pass over chunks that share a grid, each in its own frame.

        Args:
            views: of the chunks.
            coarse_grid: the chunk's coarse voxels with a margin of whole voxels on all sides.
            fine_grid: the chunk's fine voxels.
            points: [B, P, 3] where occupancy is asked for.
            coarse_target: bool [B, X, Y, Z]; the fine level is computed where it or the predicted
                coarse mask is true, so that it meets in training what it will meet at test time.
            keep: which of its valid views every voxel keeps, as at test time; None: all V views,
                invalid ones too (paper).
        """
        maps = self.encode(views.images.flatten(0, 1)) if views.maps is None else views.maps
        psi, coarse_seen = self._fuse_coarse(maps["coarse"], views, coarse_grid, keep)
        coarse, coarse_logits = self.refinement.coarse(psi, coarse_seen)
        inner = (..., *subgrid(coarse_grid, fine_grid))
        near = self._near(coarse_logits, coarse_seen, coarse_target)[inner]
        psi, active = self._fuse_fine(maps["fine"], views, fine_grid, near, keep)
        fine, fine_logits = self.refinement.fine(coarse[inner], psi, active)
        occupancy = self.decode(coarse, coarse_grid, fine, fine_grid, points)
        seen = self._seen(points, views)
        return Predictions(coarse_logits, coarse_seen, fine_logits, active, occupancy, seen)

    def _fuse_coarse(
        self, maps: Tensor, views: Views, grid: VoxelGrid, keep: KeepViews | None
    ) -> tuple[Tensor, Tensor]:
        """Fused features [B, D, X, Y, Z], and which voxels a view sees, [B, X, Y, Z]."""
        B = len(views.images)
        centers = grid.centers(maps.device).flatten(0, 2).expand(B, -1, -1)
        voxels = torch.arange(centers.shape[1], device=maps.device).expand(B, -1)
        every = torch.ones_like(voxels, dtype=torch.bool)
        fused, some = self._fuse_voxels("coarse", maps, views, centers, voxels, every, keep)
        seen = some.view(B, *grid.shape)
        psi = fused.view(B, *grid.shape, -1) * seen.unsqueeze(-1)
        return psi.permute(0, 4, 1, 2, 3), seen

    def _fuse_fine(
        self, maps: Tensor, views: Views, grid: VoxelGrid, near: Tensor, keep: KeepViews | None
    ) -> tuple[Tensor, Tensor]:
        """Fused features [B, D, X, Y, Z] of the voxels in near coarse ones, and which these are."""
        centers = grid.centers(maps.device).flatten(0, 2)
        active = self._seen(centers, views).view(-1, *grid.shape) & upsample(near, first_axis=1)
        voxels, where = _first(active.flatten(1))
        fused, _ = self._fuse_voxels("fine", maps, views, centers[voxels], voxels, where, keep)
        psi = fused.new_zeros(*active.shape, fused.shape[-1])
        psi[active] = fused
        return psi.permute(0, 4, 1, 2, 3), active

    def _fuse_voxels(
        self,
        level: str,
        maps: Tensor,
        views: Views,
        points: Tensor,
        voxels: Tensor,
        where: Tensor,
        keep: KeepViews | None,
    ) -> tuple[Tensor, Tensor]:
        """Fused features [N, D] of voxels, and whether a view sees them, bool [N].

        Args:
            level: "coarse" or "fine".
            maps: [B * V, C, h, w], of the level.
            views: of the chunks.
            points: [B, P, 3], the voxels' centres.
            voxels: int64 [B, P], their numbers in the chunk.
            where: bool [B, P], which N of them.
            keep: see `forward`.
        """
        rows = where.flatten().nonzero().squeeze(1)  # once: a mask makes the host wait each time
        measured = self._measure(level, maps, views, points).each(
            lambda values: values.flatten(0, 1).index_select(0, rows)
        )
        chunk = torch.arange(len(voxels), device=maps.device)[:, None].expand_as(voxels)
        named = [chunk, voxels, torch.full_like(voxels, LEVELS.index(level))]
        keys = torch.stack(named, dim=-1).flatten(0, 1)[rows]
        centers = views.world_T_cam[:, None, :, :3, 3] - points.unsqueeze(2)
        centers = centers.flatten(0, 1)[rows]
        kept, slots, chosen = self.keep_views(level, measured, centers, keys, keep)
        times = chosen
        if views.times is not None:
            times = views.times[keys[:, 0]]
            times = times if chosen is None else times.gather(1, chosen)
        fused, _ = self.fuse(level, self.embed_kept(level, kept), slots, times)
        return fused, measured.valid.any(1)

    def _measure(self, level: str, maps: Tensor, views: Views, points: Tensor) -> Measurements:
        """What all views of their chunks say of points [B, P, 3]: [B, P, V, ...]."""
        B, V = views.images.shape[:2]
        each = points.unsqueeze(1).expand(-1, V, -1, -1).flatten(0, 1)
        K, world_T_cam = views.K.flatten(0, 1), views.world_T_cam.flatten(0, 1)
        stereo = None if views.stereo is None else views.stereo.flatten(0, 1)
        covered = covered_pixels(maps, self.stride[level])
        found = measure(
            each,
            K,
            world_T_cam,
            invert_pose(world_T_cam),
            views.size,
            (self.config.near, self.config.far),
            lambda uv: sample_maps(maps, uv, covered),
            None if stereo is None else lambda uv: sample_maps(stereo, uv, views.size, "nearest"),
        )
        return found.each(lambda values: values.unflatten(0, (B, V)).transpose(1, 2))

    def _seen(self, points: Tensor, views: Views) -> Tensor:
        """Whether some view of their chunk sees points [B, P, 3] or [P, 3]: bool [B, P]."""
        cameras = (views.K, views.world_T_cam, views.size)
        return self.visible(points.unsqueeze(-3), *cameras).any(1)

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
    ) -> tuple[Measurements, Tensor | None, Tensor | None]:
        """The measurements that voxels keep in training: what the view store does at test time.

        Args:
            level: "coarse" or "fine".
            measured: of points in views, [P, V, ...].
            centers: [P, V, 3], see `KeepViews`.
            keys: int64 [P, 3], likewise.
            keep: chooses; None keeps everything.

        Returns:
            Measurements [P, K_t, ...], which slots are filled, bool [P, K_t], and the views in
            them, int64 [P, K_t]; None: all.
        """
        if keep is None:
            return measured, None, None
        with torch.no_grad():
            logits = None
            if keep.needs_logits:
                logits = self.selection_logits(level, self.embed(level, measured))
            views, slots = keep(logits, measured.valid, centers, keys)
        kept = measured.of_views(views)
        return kept._replace(valid=kept.valid & slots), slots, views

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
