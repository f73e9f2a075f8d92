"""The paper's runtime tables on this machine, eager beside lazy, and what memory it takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from tf_lab.benchmarks.live import live
from tf_lab.benchmarks.measure import BenchmarkSettings
from tf_lab.benchmarks.report import tables
from tf_lab.benchmarks.suite import run_all
from tf_lab.commands.inputs import first_test_scene
from tf_lab.config.build import build_network, initialise_encoder, ready, reconstruction_settings
from tf_lab.config.schema import BenchmarkConfig
from tf_lab.config.stored import portable_config
from tf_lab.data.sources.source import open_source
from tf_lab.errors import TFLabError
from tf_lab.experiments.provenance import provenance, without_places
from tf_lab.network.checkpoint import load_network, shipped_checkpoint
from tf_lab.network.network import Network
from tf_lab.reporting.figures.runtimes import runtimes
from tf_lab.support.devices import device_of
from tf_lab.support.figures import write_figure
from tf_lab.support.files import check_folder, write_json, write_text


def run(config: BenchmarkConfig) -> None:
    """Measure everything, print it, write table, JSON and chart (of live viewing alone, live.*)."""
    output = Path(config.output)
    check_folder(output)
    for name in ("views", "rooms", "counts"):
        if not getattr(config, name):
            raise TFLabError(f"{name}=[]: give a list of numbers")
    device = device_of(config.device)
    torch.manual_seed(config.seed)
    measured: dict[str, Callable[[], dict[str, Any]]] = {
        "tables": lambda: _measure_tables(config, device),
        "live": lambda: {"live": _measure_live(config, device)},
    }
    if not config.parts or not measured.keys() >= set(config.parts):
        raise TFLabError(f"parts={config.parts}: choose of {', '.join(measured)}")
    origin = provenance()  # of the code that runs, not of what HEAD becomes
    origin["machine"]["threads"] = torch.get_num_threads()
    if device.type == "cuda":
        origin["machine"]["gpu"] = torch.cuda.get_device_name(device)
    found: dict[str, Any] = {}
    for part in config.parts:
        found |= measured[part]()
    results = without_places({"config": portable_config(config), "provenance": origin, **found})
    text = tables(results)
    print(text)
    name = "benchmark" if "tables" in config.parts else "live"  # which takes no table's place
    files = [f"{name}.txt", f"{name}.json"]
    write_json(output / files[1], results)
    write_text(output / files[0], text + "\n")
    if "frame" in found:
        files.append(f"{name}.png")
        write_figure(runtimes(results).figure, output / files[-1])
    print(f"{output}: {', '.join(files)}")


def _measure_tables(config: BenchmarkConfig, device: torch.device) -> dict[str, Any]:
    networks = {
        used: _network(replace(config, filter=used), device).eval().requires_grad_(False)
        for used in (True, False)
    }
    return run_all(networks, _settings(config, device), config.views, config.eager)


def _measure_live(config: BenchmarkConfig, device: torch.device) -> dict[str, float]:
    scene = first_test_scene(open_source(config.data))
    network, _ = load_network(shipped_checkpoint())
    settings = reconstruction_settings(config.online, config.resolution, views=max(config.views))
    frames = [*range(len(scene.frames))][: config.live_frames]
    return live(ready(network, config.online, device), scene, frames, settings)


def _network(config: BenchmarkConfig, device: torch.device) -> Network:
    network = build_network(config)
    initialise_encoder(network.encoder, config.encoder, config.model.name)
    return ready(network, config.online, device)


def _settings(config: BenchmarkConfig, device: torch.device) -> BenchmarkSettings:
    reconstruction = reconstruction_settings(
        config.online, config.resolution, views=max(config.views)
    )
    return BenchmarkSettings(
        size=(config.width, config.height),
        frames=config.frames,
        timed=config.timed,
        eager_timed=config.eager_timed,
        warm_eager=device.type == "cuda" or config.online.compile,
        rooms=tuple(config.rooms),
        counts=tuple(config.counts),
        reconstruction=reconstruction,
    )
