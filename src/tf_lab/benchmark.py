"""The paper's runtime tables on this machine, eager beside lazy, and what memory it takes.

python -m tf_lab.benchmark [model=paper|small|tiny] [device=auto|cpu|cuda] [width=640 height=480]
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig

from tf_lab.benchmarks.measure import BenchmarkSettings
from tf_lab.benchmarks.report import draw, tables
from tf_lab.benchmarks.suite import run_all
from tf_lab.cli.command import command, device_of, plain
from tf_lab.config.build import make_network, ready, reconstruction_settings
from tf_lab.errors import TFLabError
from tf_lab.experiments.provenance import provenance, without_places
from tf_lab.support.files import atomic_path, check_folder, write_json


@command("benchmark", unused=("training", "optimizer"))
def main(cfg: DictConfig) -> None:
    """Measure everything, print it, write table, JSON and chart."""
    config = plain(cfg)
    output = Path(config.pop("output"))
    check_folder(output)
    device = device_of(config["device"])
    torch.manual_seed(config["seed"])
    networks = {
        used: ready(make_network({**config, "filter": used}), config, device)
        .eval()
        .requires_grad_(False)
        for used in (True, False)
    }
    origin = provenance()  # of the code that runs, not of what HEAD becomes
    origin["machine"]["threads"] = torch.get_num_threads()
    if device.type == "cuda":
        origin["machine"]["gpu"] = torch.cuda.get_device_name(device)
    found = run_all(networks, _settings(config, device), config["views"], config["eager"])
    results = without_places({"config": config, "provenance": origin, **found})
    text = tables(results)
    print(text)
    write_json(output / "benchmark.json", results)
    with atomic_path(output / "benchmark.txt") as temporary:
        temporary.write_text(text + "\n")
    with atomic_path(output / "benchmark.png") as temporary:
        draw(results, temporary)
    print(f"{output}: benchmark.txt, benchmark.json, benchmark.png")


def _settings(config: dict[str, Any], device: torch.device) -> BenchmarkSettings:
    for name in ("width", "height", "frames", "timed", "eager_timed"):
        if config[name] < 1:
            raise TFLabError(f"{name}={config[name]}: must be at least 1")
    for name in ("views", "rooms", "counts"):
        if not config[name] or min(config[name]) < 1:
            raise TFLabError(f"{name}={config[name]}: give a list of numbers of at least 1")
    return BenchmarkSettings(
        size=(config["width"], config["height"]),
        frames=config["frames"],
        timed=config["timed"],
        eager_timed=config["eager_timed"],
        warm_eager=device.type == "cuda" or config["online"]["compile"],
        rooms=tuple(config["rooms"]),
        counts=tuple(config["counts"]),
        reconstruction=reconstruction_settings(config, views=max(config["views"])),
    )


if __name__ == "__main__":
    main()
