"""All measurements in one run, so that their ratios mean something."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tf_lab.benchmarks import measure
from tf_lab.benchmarks.floor import floor
from tf_lab.benchmarks.measure import BenchmarkSettings
from tf_lab.network.network import Network
from tf_lab.progress import progress_bar


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
        By measurement, ready for JSON; times in milliseconds.
    """
    filtered, most = networks[True], max(views)
    modes = ("lazy", "eager") if eager else ("lazy",)
    found: dict[str, Any] = {"views": most, "frame": {}, "floor": {}}
    with progress_bar() as bar:
        steps = len(modes) * (len(views) + 2) + 4
        task = bar.add_task("", total=steps)

        def start(text: str) -> None:
            bar.update(task, advance=1, description=text)

        for mode in modes:
            is_eager = mode == "eager"
            for k in views:
                start(f"{mode} fusion, K = {k}")
                found["frame"][f"{mode} {k}"] = measure.per_frame(filtered, settings, is_eager, k)
            start(f"{mode} fusion without filter")
            found["frame"][f"{mode} {most} without filter"] = measure.per_frame(
                networks[False], settings, is_eager, most
            )
            start(f"{mode} floor")
            found["floor"][mode] = floor(filtered, settings, is_eager)
        start("meshing a chunk")
        found["chunk"] = measure.per_chunk(filtered, settings)
        found["chunk"].update(measure.fusion(filtered, settings))
        start("scene sizes")
        found["size"] = measure.against_size(filtered, settings)
        start("frame counts")
        found["count"] = measure.against_count(filtered, settings)
    device = next(filtered.parameters()).device
    found["peak memory"] = measure.peak_memory(device)
    found["ratios"] = ratios(found)
    return found


def ratios(found: Mapping[str, Any]) -> dict[str, float]:
    """What can be compared between machines."""
    frame, most = found["frame"], found["views"]
    lazy = _fusion(frame[f"lazy {most}"])
    out = {
        "lazy fusion over its floor": frame[f"lazy {most}"]["total"] / found["floor"]["lazy"]["ms"],
        "filter, lazy": _fusion(frame[f"lazy {most} without filter"]) / lazy,
        "frame cost, largest scene over smallest": found["size"][-1]["ms a frame"]
        / found["size"][0]["ms a frame"],
        "frame cost, most frames over fewest": found["count"][-1]["ms a frame"]
        / found["count"][0]["ms a frame"],
    }
    if "eager" in found["floor"]:
        whole = frame[f"eager {most}"]["total"]
        eager = _fusion(frame[f"eager {most}"])
        out["eager fusion over lazy"] = eager / lazy
        out["eager frame over lazy"] = whole / frame[f"lazy {most}"]["total"]
        out["filter, eager"] = _fusion(frame[f"eager {most} without filter"]) / eager
        out["eager over its floor"] = whole / found["floor"]["eager"]["ms"]
    return out


def _fusion(stages: Mapping[str, float]) -> float:
    """Milliseconds a frame without feature extraction."""
    return stages["total"] - stages["feature extraction"]
