"""Made-up finished runs, for tests of the report: the files of real ones, scores of our choice."""

import functools
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tf_lab.config.compose import compose_config
from tf_lab.config.schema import TrainConfig
from tf_lab.config.stored import write_config
from tf_lab.experiments.identity import row_label, run_directory

# The rows of the paper's tables, as one asks for them.
ROWS = {
    "Ours: w/o TRSF, avg": "fusion=avg",
    "Ours: w/o TRSF, pred": "fusion=pred",
    "Ours: w/o spatial ref.": "refine=false",
    "Ours: 4 images, RND": "views=4 select=rnd",
    "Ours: 4 images": "views=4",
    "Ours: 8 images, RND": "views=8 select=rnd",
    "Ours: 8 images": "views=8",
    "Ours: 16 images, RND": "select=rnd",
    "Ours: w/o C2F filter": "filter=false",
    "Ours: w/o projected depth": "inputs=no_depth",
    "Ours: w/o view ray": "inputs=no_ray",
    "Ours": "",
}
SCENES = ("room_2000000", "room_2000001", "room_2000002", "room_2000003")


@functools.cache
def _composed(overrides: str) -> TrainConfig:
    return compose_config("train", *overrides.split())


def scores(fscore: float) -> dict[str, float]:
    """All metrics of a scene, made up from its F-score."""
    acc, compl = 10 * (1 - fscore), 20 * (1 - fscore)
    return {
        "acc": acc,
        "compl": compl,
        "chamfer": (acc + compl) / 2,
        "prec": fscore + 0.04,
        "recall": fscore - 0.04,
        "fscore": fscore,
    }


def write_run(
    output: Path,
    overrides: str,
    seed: int,
    fscores: Sequence[float] | Mapping[str, float],
    commit: str = "1" * 40,
    written: float = 1e9,
) -> Path:
    """Write a run to ``output/runs``; F-scores by scene, or of the first scenes in order."""
    config = replace(_composed(overrides), seed=seed, output=str(output))
    by_scene = fscores if isinstance(fscores, Mapping) else dict(zip(SCENES, fscores, strict=False))
    scenes = {name: scores(value) for name, value in by_scene.items()}
    mean = {key: float(np.mean([s[key] for s in scenes.values()])) for key in scores(0)}
    run = run_directory(config)
    run.mkdir(parents=True)
    write_config(config, run / "config.yaml")
    origin = {
        "commit": commit,
        "command": f"python -m tf_lab.train {overrides} output={output}",
        "checkpoint": str(output / "trainings" / "tiny-seed0-abc" / "model.safetensors"),
        "training": {"commit": commit, "command": f"python -m tf_lab.train output={output}"},
    }
    (run / "run.json").write_text(json.dumps(origin))
    metrics = {
        "protocol": "transformerfusion",
        "label": row_label(config),
        "mean": mean,
        "scenes": scenes,
    }
    (run / "metrics.json").write_text(json.dumps(metrics))
    os.utime(run / "metrics.json", (written, written))
    return run


def change_scores(run: Path, *without: str, **more: float) -> None:
    """Take metrics out of a run's scores, or put some in, of every scene and of the mean."""
    path = run / "metrics.json"
    metrics, written = json.loads(path.read_text()), path.stat().st_mtime
    for each in (metrics["mean"], *metrics["scenes"].values()):
        each.update(more)
        for name in without:
            del each[name]
    path.write_text(json.dumps(metrics))
    os.utime(path, (written, written))


def write_study(
    output: Path,
    fscores: Mapping[str, float],
    seeds: Sequence[int] = (0, 1, 2),
    noise: float = 0.01,
    common: str = "",
) -> Path:
    """Runs of rows about their mean F-scores, with effects of seed, scene and both, zero in sum.

    Returns:
        The folder of the runs.
    """
    rng = np.random.default_rng(0)
    by_scene = centred(rng.normal(0, 0.05, len(SCENES)))
    for row, mean in fscores.items():
        of_seeds = centred(rng.normal(0, noise, (len(seeds), 1)))
        rest = centred(rng.normal(0, noise, (len(seeds), len(SCENES))))
        values = mean + by_scene + of_seeds + rest
        for seed, line in zip(seeds, values, strict=True):
            write_run(output, f"{ROWS[row]} {common}".strip(), seed, line.tolist())
    return output / "runs"


def centred(values: np.ndarray) -> np.ndarray:
    """Values less their mean."""
    return values - values.mean()
