"""The least time that this machine needs: counted work over measured rates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial

import torch
import torch.nn.functional as F
from torch.utils.flop_counter import FlopCounterMode

from tf_lab.benchmarks import measure
from tf_lab.benchmarks.measure import CHUNK_STAGES, STAGES, BenchmarkSettings
from tf_lab.benchmarks.meter import clock
from tf_lab.network.network import Network
from tf_lab.online.lattice.level import Level
from tf_lab.online.reconstructor import Reconstructor

TIMES = 10  # a rate is measured; the best counts
Work = dict[str, float]  # "flops", "bytes", "ms"


@torch.inference_mode()
def rates(device: torch.device, dtype: torch.dtype) -> dict[str, float]:
    """The most FLOP/s and bytes/s that this machine shows, at sizes as the stages have them.

    FLOP/s of matrix products, square and as of tokens, and of a convolution; bytes/s (read and
    written) of copies that fit in a cache and of some that do not.
    """
    n, most = (8192, 28) if device.type == "cuda" else (1024, 24)
    square = torch.randn(n, n, device=device, dtype=dtype)
    tokens = torch.randn(1 << 14, 256, device=device, dtype=dtype)
    layer = torch.randn(256, 1024, device=device, dtype=dtype)
    maps = torch.randn(1, 256, 60, 80, device=device, dtype=dtype)
    kernel = torch.randn(256, 256, 3, 3, device=device, dtype=dtype)
    seconds = _best_of(device)
    flops = [
        2 * n**3 / seconds(lambda: square @ square),
        2 * tokens.numel() * layer.shape[1] / seconds(lambda: tokens @ layer),
        2
        * maps[0, 0].numel()
        * kernel.numel()
        / seconds(lambda: F.conv2d(maps, kernel, padding=1)),
    ]
    x = torch.zeros(1 << most, device=device)
    y = torch.zeros_like(x)
    moved = []
    for bits in range(16, most + 1, 4):
        a, b = x[: 1 << bits], y[: 1 << bits]
        moved.append(2 * a.nbytes / seconds(partial(a.copy_, b)))
    return {"flops": max(flops), "bytes": max(moved)}


def _best_of(device: torch.device) -> Callable[[Callable[[], object]], float]:
    now = clock(device)

    def seconds(work: Callable[[], object]) -> float:
        found = []
        for _ in range(TIMES):
            start = now()
            work()
            found.append(now() - start)
        return min(found)

    return seconds


@contextmanager
def counting() -> Iterator[Callable[[], float]]:
    """Counts FLOPs, of compiled modules too; gives what reads the sum so far."""
    with torch.compiler.set_stance("force_eager"), FlopCounterMode(display=False) as counter:
        yield counter.get_total_flops


def frame_floor(
    network: Network, settings: BenchmarkSettings, eager: bool, rate: Mapping[str, float]
) -> dict[str, Work]:
    """What adding a frame takes at least, by stage, with the frames that `per_frame` times."""
    r, frames = measure.at_work(network, settings, eager)
    seen = measure.frame_meter(r, lambda: measure.measurements(r))
    with counting() as flops:
        work = measure.frame_meter(r, flops)
        for frame in frames:
            r.add_frame(*frame)
    done, voxels = work.take(), seen.take()
    return _with_total(
        {
            stage: _work(
                done[stage] / len(frames), _bytes(r, stage, voxels[stage] / len(frames)), rate
            )
            for stage in STAGES
            if stage in done
        }
    )


def chunk_floor(
    network: Network, settings: BenchmarkSettings, rate: Mapping[str, float]
) -> dict[str, Work]:
    """What meshing a chunk takes at least, by stage; only FLOPs are counted."""
    r, region = measure.with_chunk(network, settings)
    with counting() as flops:
        work = measure.chunk_meter(r, flops)
        measure.mesh_again(r, region)
    done = work.take()
    return _with_total({stage: _work(done[stage], 0, rate) for stage in CHUNK_STAGES})


def _work(flops: float, moved: float, rate: Mapping[str, float]) -> Work:
    ms = 1000 * max(flops / rate["flops"], moved / rate["bytes"])
    return {"flops": flops, "bytes": moved, "ms": ms}


def _with_total(stages: dict[str, Work]) -> dict[str, Work]:
    """One stage comes after the other, so their least times add up."""
    total = {key: sum(work[key] for work in stages.values()) for key in ("flops", "bytes", "ms")}
    return {**stages, "total": total}


def _bytes(r: Reconstructor, stage: str, voxels: float) -> float:
    """What a stage must read or write, if caches forget nothing while it lasts."""
    if stage == "feature extraction":
        weights = sum(p.nbytes for p in r.network.encoder.parameters())
        maps = sum(r.frames.map_nbytes(level.name) for level in (r.coarse, r.fine))
        return weights + r.frames.images[0].nbytes + maps
    if stage == "near-surface masks":
        return 0
    return _measuring(r, r.coarse if stage == "coarse fusion" else r.fine, voxels)


def _measuring(r: Reconstructor, level: Level, voxels: float) -> float:
    """Bytes of the samples (each texel once) and of the logits that select."""
    channels = r.network.encoder.channels[level.name]
    texels = 4 * voxels * channels * r.frames.dtype.itemsize
    return min(texels, r.frames.map_nbytes(level.name)) + voxels * level.store.logits[:1].nbytes
