"""The measurements, each a function of a network and `BenchmarkSettings`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from tf_lab.benchmarks.eager import EagerReconstructor
from tf_lab.benchmarks.known import EagerOnKnownSurface, KnownSurface, LazyOnKnownSurface
from tf_lab.benchmarks.meter import Meter, clock
from tf_lab.benchmarks.rooms import Rooms, walk
from tf_lab.geometry import CHUNK, COARSE, FINE
from tf_lab.network.network import Network
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.settings import ReconstructionSettings

STAGES = ("feature extraction", "coarse fusion", "near-surface masks", "fine fusion")
CHUNK_STAGES = ("coarse refinement", "fine refinement", "occupancy", "marching cubes")
FUSED = 1000  # voxels, for the cost of fusion by itself

Frame = tuple[np.ndarray, ...]  # image, K, world_T_cam
Region = tuple[list[float], list[float]]  # lower and upper corner, metres


@dataclass(frozen=True)
class BenchmarkSettings:
    """What is measured.

    Attributes:
        size: (width, height) of the images.
        frames: added to every room before anything is timed.
        timed: frames over which lazy fusion is timed.
        eager_timed: the same for eager fusion, which takes much longer.
        warm_eager: whether eager fusion gets a frame to warm up, too.
        rooms: room counts for the cost against scene size.
        counts: frame counts for the cost against time.
        reconstruction: views and precisions.
    """

    size: tuple[int, int]
    frames: int
    timed: int
    eager_timed: int
    warm_eager: bool
    rooms: tuple[int, ...]
    counts: tuple[int, ...]
    reconstruction: ReconstructionSettings


def prepared(
    network: Network, settings: BenchmarkSettings, rooms: int, eager: bool = False, views: int = 0
) -> Reconstructor:
    """A reconstruction that has seen some rooms and knows where their surface is.

    Every voxel counts as fused (its features are noise), so that what comes next is measured as in
    the middle of a scene, without the hours that it takes to come there eagerly.
    """
    reconstruction = settings.reconstruction
    if views:
        reconstruction = replace(reconstruction, views=views)
    r = (EagerOnKnownSurface if eager else LazyOnKnownSurface)(network, reconstruction)
    assert isinstance(r.pipeline, KnownSurface)
    r.pipeline.solid = Rooms(rooms).solid
    if isinstance(r, EagerReconstructor):
        r.literal = False
    for frame in walk(range(rooms), settings.frames, settings.size):
        r.add_frame(*frame)
    settle(r)
    if isinstance(r, EagerReconstructor):
        r.literal = True
    return r


@torch.inference_mode()
def settle(r: Reconstructor) -> None:
    """Find the surface, and count all voxels as fused."""
    for level in (r.coarse, r.fine):
        if level is r.fine:
            r.pipeline.refine_coarse(None)
            r.pipeline.mask_coarse(None)
        rows = (level.store.seen > 0).nonzero()[:, 0]
        level.put(rows, torch.randn_like(level.features["psi"][rows]))


def at_work(
    network: Network, settings: BenchmarkSettings, eager: bool, views: int = 0
) -> tuple[Reconstructor, list[Frame]]:
    """A prepared reconstruction, warm, and the frames to measure: poses that it has not seen."""
    r = prepared(network, settings, 1, eager, views)
    frames = list(walk(range(1), settings.frames + 1, settings.size))
    if settings.warm_eager or not eager:
        r.add_frame(*frames.pop())
    count = settings.eager_timed if eager else settings.timed
    return r, [frames[int((i + 0.5) / count * len(frames))] for i in range(count)]


def frame_meter(r: Reconstructor, read: Callable[[], float]) -> Meter:
    """Watches the stages of adding a frame."""
    meter = Meter(read)
    meter.watch(r, "add_frame", STAGES[0])  # with checking and sending the image
    meter.watch(r, "see", STAGES[1])  # with finding the voxels in view
    meter.watch(r, "see_coarse", STAGES[1])
    meter.watch(r.pipeline, "update_coarse", STAGES[2])
    meter.watch(r, "see_fine", STAGES[3])
    meter.watch(r.pipeline, "discover", "earlier views")
    return meter


def per_frame(
    network: Network, settings: BenchmarkSettings, eager: bool, views: int
) -> dict[str, float]:
    """Milliseconds a frame by stage, "total" without "earlier views", and "fps"."""
    r, frames = at_work(network, settings, eager, views)
    meter = frame_meter(r, clock(r.device))
    for frame in frames:
        r.add_frame(*frame)
    found = {stage: 1000 * s / len(frames) for stage, s in meter.take().items()}
    found["total"] = sum(found.get(stage, 0.0) for stage in STAGES)
    found["fps"] = 1000 / found["total"]
    return found


def with_chunk(network: Network, settings: BenchmarkSettings) -> tuple[Reconstructor, Region]:
    """A prepared reconstruction, and a region in its fullest chunk."""
    r = prepared(network, settings, 1)
    chunks = torch.div(r.fine.blocks.coords, round(CHUNK / COARSE), rounding_mode="floor")
    chunks, filled = torch.unique(chunks, dim=0, return_counts=True)
    centre = (chunks[filled.argmax()].cpu().numpy() + 0.5) * CHUNK
    return r, ((centre - 0.1).tolist(), (centre + 0.1).tolist())


def chunk_meter(r: Reconstructor, read: Callable[[], float]) -> Meter:
    """Watches the stages of meshing."""
    meter = Meter(read)
    for method in ("refine_coarse", "mask_coarse"):
        meter.watch(r.pipeline, method, CHUNK_STAGES[0])
    for method in ("refine_fine", "mask_fine"):
        meter.watch(r.pipeline, method, CHUNK_STAGES[1])
    meter.watch(r.pipeline, "update_values", CHUNK_STAGES[2])
    meter.watch(r.surface, "update", CHUNK_STAGES[3])
    return meter


@torch.inference_mode()
def mesh_again(r: Reconstructor, region: Region) -> int:
    """Mesh a region as if all that lies before marching cubes, fusion apart, were out of date."""
    for level in (r.coarse, r.fine):
        for stage in ("refined", "near", "values"):
            level.flags[stage][:] = True
    return len(r.mesh(region, color=False).faces)


def per_chunk(network: Network, settings: BenchmarkSettings) -> dict[str, float]:
    """Milliseconds by stage to mesh the fullest chunk, with the surroundings that it needs."""
    r, region = with_chunk(network, settings)
    mesh_again(r, region)  # warms up
    meter = chunk_meter(r, clock(r.device))
    faces = mesh_again(r, region)
    found = {stage: 1000 * s for stage, s in meter.take().items()}
    return {**found, "total": sum(found[stage] for stage in CHUNK_STAGES), "faces": faces}


@torch.inference_mode()
def fusion(network: Network, settings: BenchmarkSettings) -> dict[str, float]:
    """Milliseconds to fuse 1000 voxels, which lazy fusion puts off until a mesh is asked for.

    Those that most frames have seen; "views" is how many they hold on average.
    """
    r = prepared(network, settings, 1)
    rows = r.fine.store.seen.topk(min(FUSED, len(r.fine.store.seen))).indices
    views = float(r.fine.store.filled[rows].sum()) / len(rows)
    now, times = clock(r.device), []
    for _ in range(2):
        start = now()
        with r.precision():
            r.fine.fuse(rows, len(rows))
        times.append(now() - start)
    return {"fuse 1000 voxels": 1000 * min(times) * FUSED / len(rows), "views": views}


def against_size(network: Network, settings: BenchmarkSettings) -> list[dict[str, Any]]:
    """Cost of a frame and memory, by how many rooms the scene has.

    Where there is a room beside it, a camera sees more: the cost is also told by voxel in view.
    """
    found = []
    for rooms in settings.rooms:
        r = prepared(network, settings, rooms)
        last = range(rooms - 1, rooms)
        voxels = sum(int((x.store.seen > 0).sum()) for x in (r.coarse, r.fine))
        coords = r.coarse.blocks.coords.cpu().numpy() * 3
        box = float(np.prod(np.ptp(coords, 0) + 3)) * (1 + (COARSE / FINE) ** 3)
        memory, before = r.memory, measurements(r)
        took = _median_frame(r, settings, last)
        in_view = (measurements(r) - before) / settings.timed
        found.append(
            {
                "rooms": rooms,
                "ms a frame": took,
                "voxels in view": in_view,
                "us a voxel in view": 1000 * took / in_view,
                "voxels seen": voxels,
                "voxels in the bounding box": round(box),
                "memory": memory,
                "bytes a voxel": memory["view sets"] / (r.coarse.blocks.rows + r.fine.blocks.rows),
            }
        )
    return found


def against_count(network: Network, settings: BenchmarkSettings) -> list[dict[str, float]]:
    """Cost of a frame by how many frames have been added before."""
    r = prepared(network, replace(settings, frames=min(settings.counts)), 1)
    found = []
    for count in sorted(settings.counts):
        frames = walk(range(1), max(1, count - len(r.frames)), settings.size)
        while len(r.frames) < count:
            r.add_frame(*next(frames))
        before = len(r.frames)
        found.append({"frames": before, "ms a frame": _median_frame(r, settings, range(1))})
    return found


def measurements(r: Reconstructor) -> int:
    """How often any voxel has been seen by any frame."""
    return sum(int(x.store.seen.sum()) for x in (r.coarse, r.fine))


def _median_frame(r: Reconstructor, settings: BenchmarkSettings, rooms: range) -> float:
    """Milliseconds to add a frame, without its feature extraction."""
    meter = frame_meter(r, clock(r.device))
    times = []
    for frame in walk(rooms, settings.timed, settings.size):
        r.add_frame(*frame)
        stages = meter.take()
        times.append(sum(stages.get(stage, 0.0) for stage in STAGES[1:]))
    return 1000 * float(np.median(times))
