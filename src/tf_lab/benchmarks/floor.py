"""The least time that this machine needs: counted work over measured rates."""

from __future__ import annotations

from typing import Any

import torch
from torch.utils.flop_counter import FlopCounterMode

from tf_lab.benchmarks.measure import BenchmarkSettings, prepared
from tf_lab.benchmarks.rooms import walk
from tf_lab.benchmarks.stopwatch import Stopwatch
from tf_lab.network.network import Network
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.settings import DTYPES


def rates(device: torch.device, dtype: torch.dtype) -> dict[str, float]:
    """Measured FLOP/s of a large matrix product, and bytes/s of a large copy (read and write)."""
    n = 8192 if device.type == "cuda" else 1024
    a = torch.randn(n, n, device=device).to(dtype)
    x = torch.empty(2**28 if device.type == "cuda" else 2**24, device=device)
    y = torch.zeros_like(x)
    watch = Stopwatch(device)

    def best(work: Any) -> float:
        times = []
        for _ in range(5):
            start = watch.now()
            work()
            times.append(watch.now() - start)
        return min(times)

    return {
        "flops": 2 * n**3 / best(lambda: a @ a),
        "bytes": 2 * x.nbytes / best(lambda: x.copy_(y)),
    }


@torch.inference_mode()
def floor(network: Network, settings: BenchmarkSettings, eager: bool) -> dict[str, float]:
    """FLOPs and least bytes of adding a frame, and the time that they must take: milliseconds."""
    r = prepared(network, settings, 1, eager)
    frame = next(walk(range(1), settings.frames + 1, settings.size))
    seen = _measurements(r)
    with FlopCounterMode(display=False) as counter:
        r.add_frame(*frame)
    flops = counter.get_total_flops()
    moved = _bytes(r, _measurements(r) - seen)
    rate = rates(r.device, DTYPES[r.settings.precision])
    return {
        "flops": flops,
        "bytes": moved,
        "flop rate": rate["flops"],
        "byte rate": rate["bytes"],
        "ms": 1000 * max(flops / rate["flops"], moved / rate["bytes"]),
    }


def _measurements(r: Reconstructor) -> int:
    return sum(int(x.store.seen.sum()) for x in (r.coarse, r.fine))


def _bytes(r: Reconstructor, measurements: int) -> float:
    """What must be read or written at least: weights, image, maps, samples and view sets."""
    weights = sum(p.nbytes for p in r.network.encoder.parameters())
    maps = r.frames.nbytes / len(r.frames)
    features = r.network.config.encoder["fine_channels"]
    sample = 4 * features * DTYPES[r.settings.maps].itemsize
    sets = 2 * r.fine.store.nbytes / max(1, r.fine.blocks.rows)
    return weights + r.frames.images[0].nbytes + maps + measurements * (sample + sets)
