"""The measurements, each a function of a network and `BenchmarkSettings`."""

from __future__ import annotations

import resource
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from tf_lab.benchmarks.rooms import Rooms, walk
from tf_lab.benchmarks.stopwatch import Stopwatch
from tf_lab.geometry import CHUNK, COARSE, FINE
from tf_lab.network.network import Network
from tf_lab.online.eager import EagerReconstructor
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.settings import ReconstructionSettings

STAGES = ("feature extraction", "coarse fusion", "near-surface masks", "fine fusion")
CHUNK_STAGES = ("coarse refinement", "fine refinement", "occupancy", "marching cubes")
FUSED = 1000  # voxels, for the cost of fusion by itself


@dataclass(frozen=True)
class BenchmarkSettings:
    """What is measured.

    Attributes:
        size: (width, height) of the images.
        frames: added to every room before anything is timed.
        timed: frames over which lazy fusion is timed.
        eager_timed: the same for eager fusion, which takes much longer.
        rooms: room counts for the cost against scene size.
        counts: frame counts for the cost against time.
        reconstruction: views and precisions.
    """

    size: tuple[int, int]
    frames: int
    timed: int
    eager_timed: int
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
    r = (EagerReconstructor if eager else Reconstructor)(network, reconstruction)
    Rooms(rooms).install(r)
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
        level.features["psi"].normal_()
        level.store.dirty[:] = False


def watched(r: Reconstructor) -> Stopwatch:
    """A stopwatch on the stages of adding a frame."""
    watch = Stopwatch(r.device)
    watch.watch(r.frames, "_load", STAGES[0])
    watch.watch(r, "_see_coarse", STAGES[1])
    watch.watch(r.pipeline, "update_coarse", STAGES[2])
    watch.watch(r, "_see_fine", STAGES[3])
    watch.watch(r.pipeline, "discover", "earlier views")
    return watch


def per_frame(
    network: Network, settings: BenchmarkSettings, eager: bool, views: int
) -> dict[str, float]:
    """Milliseconds a frame by stage, "total" without "earlier views", and "fps"."""
    r = prepared(network, settings, 1, eager, views)
    count = settings.eager_timed if eager else settings.timed
    frames = list(walk(range(1), settings.frames + 1, settings.size))  # other poses than before
    if not eager:
        r.add_frame(*frames[-1])  # warm
    watch = watched(r)
    for i in range(count):
        r.add_frame(*frames[i % len(frames)])
    found = {stage: 1000 * s / count for stage, s in watch.take().items()}
    found["total"] = sum(found.get(stage, 0.0) for stage in STAGES)
    found["fps"] = 1000 / found["total"]
    return found


@torch.inference_mode()
def per_chunk(network: Network, settings: BenchmarkSettings) -> dict[str, float]:
    """Milliseconds by stage to mesh the fullest chunk, with the surroundings that it needs."""
    r = prepared(network, settings, 1)
    chunks = torch.div(r.fine.blocks.coords, round(CHUNK / COARSE), rounding_mode="floor")
    chunks, filled = torch.unique(chunks, dim=0, return_counts=True)
    centre = (chunks[filled.argmax()].cpu().numpy() + 0.5) * CHUNK
    found: dict[str, float] = {}
    for _ in range(2):  # the first time warms up
        for level in (r.coarse, r.fine):
            for stage in ("refined", "near", "values"):
                level.flags[stage][:] = True
        watch = Stopwatch(r.device)
        for method in ("refine_coarse", "mask_coarse"):
            watch.watch(r.pipeline, method, CHUNK_STAGES[0])
        for method in ("refine_fine", "mask_fine"):
            watch.watch(r.pipeline, method, CHUNK_STAGES[1])
        watch.watch(r.pipeline, "update_values", CHUNK_STAGES[2])
        watch.watch(r.surface, "update", CHUNK_STAGES[3])
        region = (centre - 0.1).tolist(), (centre + 0.1).tolist()
        mesh = r.mesh(region, color=False)
        found = {stage: 1000 * s for stage, s in watch.take().items()}
    found["total"] = sum(found[stage] for stage in CHUNK_STAGES)
    found["faces"] = len(mesh.faces)
    return found


@torch.inference_mode()
def fusion(network: Network, settings: BenchmarkSettings) -> dict[str, float]:
    """Milliseconds to fuse 1000 voxels, which lazy fusion puts off until a mesh is asked for."""
    r = prepared(network, settings, 1)
    rows = r.fine.store.seen.topk(min(FUSED, len(r.fine.store.seen))).indices
    watch = Stopwatch(r.device)
    with r._precision():
        best = min(_seconds(watch, lambda: r.fine.fuse(rows, len(rows))) for _ in range(2))
    return {"fuse 1000 voxels": 1000 * best * FUSED / len(rows)}


def against_size(network: Network, settings: BenchmarkSettings) -> list[dict[str, Any]]:
    """Cost of a frame and memory, by how many rooms the scene has."""
    found = []
    for rooms in settings.rooms:
        r = prepared(network, settings, rooms)
        last = range(rooms - 1, rooms)
        voxels = sum(int((x.store.seen > 0).sum()) for x in (r.coarse, r.fine))
        low, high = (f(r.coarse.blocks.coords * 3) for f in (_least, _most))
        box = float(np.prod(high - low + 3)) * (1 + (COARSE / FINE) ** 3)
        memory = r.memory
        found.append(
            {
                "rooms": rooms,
                "ms a frame": _median_frame(r, settings, last),
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


def _median_frame(r: Reconstructor, settings: BenchmarkSettings, rooms: range) -> float:
    """Milliseconds to add a frame, without its feature extraction."""
    watch = watched(r)
    times = []
    for frame in walk(rooms, settings.timed, settings.size):
        r.add_frame(*frame)
        stages = watch.take()
        times.append(sum(stages.get(stage, 0.0) for stage in STAGES[1:]))
    return 1000 * float(np.median(times))


def peak_memory(device: torch.device) -> int:
    """Bytes, at most, that this process has had on the device."""
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _seconds(watch: Stopwatch, work: Callable[[], Any]) -> float:
    start = watch.now()
    work()
    return watch.now() - start


def _least(coords: torch.Tensor) -> np.ndarray:
    return coords.amin(0).cpu().numpy()


def _most(coords: torch.Tensor) -> np.ndarray:
    return coords.amax(0).cpu().numpy()
