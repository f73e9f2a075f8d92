"""All measurements in one run, so that their ratios mean something."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from tf_lab.benchmarks import measure
from tf_lab.benchmarks.floor import chunk_floor, frame_floor, rates
from tf_lab.benchmarks.measure import BenchmarkSettings
from tf_lab.benchmarks.memory import peak_memory, reset_peak
from tf_lab.network.network import Network
from tf_lab.online.precision import dtype_of
from tf_lab.support.progress import progress_bar


def run_all(
    networks: Mapping[bool, Network],
    settings: BenchmarkSettings,
    views: Sequence[int],
    eager: bool,
) -> dict[str, Any]:
    """Measure.

    Args:
        networks: with (True) and without (False) coarse-to-fine filtering.
        settings: what is measured.
        views: the K to compare.
        eager: whether eager fusion is measured too.

    Returns:
        By measurement, ready for JSON; times in milliseconds, memory in bytes.
    """
    network, most = networks[True], max(views)
    modes = ("lazy", "eager") if eager else ("lazy",)
    device = next(network.parameters()).device
    dtype = dtype_of(settings.reconstruction.precision, device)
    frame: dict[str, Any] = {}
    floor: dict[str, Any] = {}
    memory: dict[str, int] = {}
    with progress_bar() as bar:
        task = bar.add_task("", total=len(modes) * (len(views) + 2) + 6)

        def run(name: str, work: Callable[[], Any]) -> Any:
            bar.update(task, description=name)
            reset_peak(device)
            result = work()
            memory[name] = peak_memory(device)
            bar.advance(task)
            return result

        rate = run("rates", partial(rates, device, dtype))
        for mode in modes:
            cases = {f"{mode} {k}": (network, k) for k in views}
            cases[f"{mode} {most} without filter"] = (networks[False], most)
            for name, (used, k) in cases.items():
                frame[name] = run(
                    name, partial(measure.per_frame, used, settings, mode == "eager", k)
                )
            floor[mode] = run(
                f"{mode} floor", partial(frame_floor, network, settings, mode == "eager", rate)
            )
        chunk = run("chunk", partial(measure.per_chunk, network, settings))
        floor["chunk"] = run("chunk floor", partial(chunk_floor, network, settings, rate))
        chunk |= run("fusion", partial(measure.fusion, network, settings))
        size = run("scene sizes", partial(measure.against_size, network, settings))
        count = run("frame counts", partial(measure.against_count, network, settings))
    found = {
        "views": most,
        "precision": str(dtype).removeprefix("torch."),
        "rates": rate,
        "frame": frame,
        "chunk": chunk,
        "floor": floor,
        "size": size,
        "count": count,
        "peak memory": {name: memory[name] for name in (*frame, "chunk")},
    }
    return {**found, "ratios": ratios(found)}


def ratios(found: Mapping[str, Any]) -> dict[str, float]:
    """What can be compared between machines."""
    frame, floor, most = found["frame"], found["floor"], found["views"]
    lazy = frame[f"lazy {most}"]
    out = {
        "lazy frame over its floor": lazy["total"] / floor["lazy"]["total"]["ms"],
        "chunk over its floor": found["chunk"]["total"] / floor["chunk"]["total"]["ms"],
        "filter, lazy": _fusion(frame[f"lazy {most} without filter"]) / _fusion(lazy),
    }
    for what, name, few, many in (
        ("us a voxel in view", "rooms", found["size"][0], found["size"][-1]),
        ("ms a frame", "rooms", found["size"][0], found["size"][-1]),
        ("ms a frame", "frames", found["count"][0], found["count"][-1]),
    ):
        out[f"{what}, {many[name]} {name} over {few[name]}"] = many[what] / few[what]
    if "eager" in floor:
        eager = frame[f"eager {most}"]
        out["eager fusion over lazy"] = _fusion(eager) / _fusion(lazy)
        out["eager frame over lazy"] = eager["total"] / lazy["total"]
        out["filter, eager"] = _fusion(frame[f"eager {most} without filter"]) / _fusion(eager)
        out["eager frame over its floor"] = eager["total"] / floor["eager"]["total"]["ms"]
    return out


def _fusion(stages: Mapping[str, float]) -> float:
    """Milliseconds a frame without feature extraction."""
    return stages["total"] - stages["feature extraction"]
