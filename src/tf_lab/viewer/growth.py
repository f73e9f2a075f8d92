"""A reconstruction that is meshed bit by bit, so that nobody waits for all of it."""

from __future__ import annotations

from collections import Counter

import numpy as np
import torch
import trimesh

from tf_lab.data.capture import Capture
from tf_lab.geometry import CHUNK, FINE
from tf_lab.meshes.weld import Part
from tf_lab.network.network import Network
from tf_lab.online.lattice.level import Level
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.online.surface import Chunk, spanned

Pieces = dict[Chunk, trimesh.Trimesh | None]
"""Meshes (metres) by chunk; None where there is no surface any more."""

SPREAD = 0.05  # metres inside a chunk's faces: a box that touches no other chunk


class Growth:
    """A reconstruction and which chunks of it are out of date.

    Attributes:
        stale: chunks, with how often a frame changed them since they were meshed.
        pieces: the mesh as of now, by chunk.
        sources: the capture's frame behind every frame of the reconstruction.
    """

    def __init__(self, network: Network, settings: ReconstructionSettings) -> None:
        self.reconstructor = Reconstructor(network, settings)
        self.stale: Counter[Chunk] = Counter()
        self.pieces: dict[Chunk, trimesh.Trimesh] = {}
        self.sources: list[int] = []
        self.settled = True
        self._parts: dict[Chunk, Part] = {}  # of the surface, as they were last seen
        self._known = False  # whether the last chunk was one with a surface, if there was any

    def __len__(self) -> int:
        return len(self.sources)

    def add(self, capture: Capture, frame: int) -> None:
        """Add a frame of a capture. Raises TFLabError: it cannot be used; nothing has changed."""
        r = self.reconstructor
        r.add_frame(capture.image(frame), capture.K[frame], capture.world_T_cam[frame])
        self.sources.append(frame)
        self.settled = False
        for level in (r.coarse, r.fine):
            self.stale.update(_changed(level))

    def mesh_next(self, roughly: bool = False) -> Pieces:
        """Mesh the chunk that waits most urgently; what is other than before.

        Args:
            roughly: as of `Reconstructor.update`; only `settle` makes that good everywhere.
        """
        chunk = self._most_urgent()
        del self.stale[chunk]
        low = np.array(chunk) * CHUNK
        self.reconstructor.update((low + SPREAD, low + CHUNK - SPREAD), roughly)
        return self._news()

    def settle(self) -> Pieces:
        """Mesh all that is out of date; what is other than before."""
        self.stale.clear()
        self.reconstructor.update()
        self.settled = True
        return self._news()

    def near(self, level: str) -> np.ndarray:
        """Centres [N, 3] (metres) of the voxels whose mask says near the surface, as of now."""
        store = self.reconstructor.coarse if level == "coarse" else self.reconstructor.fine
        rows = (store.active & store.features["near"]).nonzero()[:, 0]
        return store.points(rows).cpu().numpy()

    def hit(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray | None:
        """Where a ray first meets the mesh, from the front: [3], metres; None: nowhere."""
        found = []
        for piece in self.pieces.values():
            low, high = piece.bounds
            if _meets(origin, direction, low, high):
                points, _, faces = piece.ray.intersects_location([origin], [direction])
                front = piece.face_normals[faces] @ direction < 0
                found.extend(points[front])
        if not found:
            return None
        return np.array(min(found, key=lambda point: float((point - origin) @ direction)))

    def _most_urgent(self) -> Chunk:
        """Of the stale chunks the one that frames changed most often.

        By turns of those with a surface and of those without: frames reach behind walls, and
        while all that is there was looked at, the mesh would stay as it is.
        """
        self._known = not self._known
        kind = [chunk for chunk in self.stale if (chunk in self.pieces) == self._known]
        return max(kind or self.stale, key=self.stale.__getitem__)

    def _news(self) -> Pieces:
        """Chunks whose surface is another one than when this was last asked."""
        surface = self.reconstructor.surface
        now = surface.parts
        changed = [chunk for chunk, part in now.items() if not _same(self._parts.get(chunk), part)]
        gone = self._parts.keys() - now.keys()
        self._parts = {**now}
        scale = FINE / surface.n
        fresh: Pieces = dict.fromkeys(gone)
        for chunk in changed:
            vertices, faces = now[chunk]
            fresh[chunk] = trimesh.Trimesh((vertices + 0.5) * scale, faces, process=False)
        for chunk, piece in fresh.items():
            self.pieces.pop(chunk, None)
            if piece is not None:
                self.pieces[chunk] = piece
        return fresh


def _changed(level: Level) -> set[Chunk]:
    """Chunks with a part of blocks with voxels whose views changed since they were fused."""
    blocks, store = level.blocks, level.store
    changed = (store.dirty & (store.seen > 0)).view(-1, blocks.volume).any(1)
    coords = blocks.coords[changed & level.flags["open"]]
    edge = level.voxel * blocks.edge
    corners = torch.stack([coords * edge + SPREAD, (coords + 1) * edge - SPREAD])
    return spanned((corners / CHUNK).floor().long())


def _same(old: Part | None, new: Part) -> bool:
    """Whether a chunk was meshed again to the same surface."""
    if old is None or old is new:
        return old is new
    return all(np.array_equal(a, b) for a, b in zip(old, new, strict=True))


def _meets(origin: np.ndarray, direction: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether a ray meets a box (Kay & Kajiya 1986)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (low - origin) / direction, (high - origin) / direction
    near, far = np.fmin(first, second).max(), np.fmax(first, second).min()
    return bool(far >= max(near, 0))
