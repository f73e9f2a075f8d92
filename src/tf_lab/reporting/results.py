"""Finished runs as records: which row of the paper a run is, of which seed, and its scores."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tf_lab.config.schema import TrainConfig
from tf_lab.config.stored import read_config, stored_config, write_config
from tf_lab.errors import TFLabError
from tf_lab.evaluation.scores import Metrics, Scores, mean_scores
from tf_lab.experiments import inventory
from tf_lab.experiments.identity import (
    changed_settings,
    evaluation_identity,
    row_label,
    training_identity,
)
from tf_lab.experiments.provenance import Origin, sessions_of, without_places
from tf_lab.experiments.reuse import removal
from tf_lab.support.documents import read_json
from tf_lab.support.files import write_json
from tf_lab.support.layout import CONFIG, ORIGIN, SCORES
from tf_lab.support.records import read_record

# What makes a run another row, or another repetition of one, of the same study; and which metrics
# were measured beside the paper's, which makes no difference to those.
ROW_SETTINGS = ("fusion", "inputs", "refine", "filter", "views", "select", "seed", "metrics")


@dataclass(frozen=True)
class Run:
    """A finished run.

    Attributes:
        directory: where it lies.
        row: its name in the paper's tables, told from the config.
        seed: of its training.
        config: resolved.
        settings: what has to be equal for runs to be comparable, by dotted name.
        scenes: scores by test scene; of an older run, or one without further metrics, some may
            lack.
        makers: provenances of the evaluation, of the training, and of each session of it.
        finished: when its ``metrics.json`` was written, seconds since 1970.
        view_sets: means over scenes of what `tf_lab.online.views.statistics.ViewSets` has; none in
            an older run.
    """

    directory: Path
    row: str
    seed: int
    config: TrainConfig
    settings: dict[str, Any]
    scenes: dict[str, Scores]
    makers: tuple[Origin, ...]
    finished: float
    view_sets: dict[str, float] = field(default_factory=dict)


def find_runs(folders: Iterable[Path]) -> tuple[list[Run], list[str]]:
    """All finished runs in some folders, however deep, and one line on each that is damaged.

    Raises:
        TFLabError: a folder does not exist, or there is no run that can be read.
    """
    runs, damaged = [], []
    folders = list(folders)
    if not folders:
        raise TFLabError("runs=[]: give a folder of runs, or several")
    for folder in folders:
        if not folder.is_dir():
            what = "is no folder" if folder.exists() else "there is no such folder"
            raise TFLabError(f"{folder}: {what}; {_what_to_do(folders)}")
        for path in sorted(folder.rglob(SCORES)):
            if any(part.startswith(".") for part in path.relative_to(folder).parts):
                continue  # half removed
            try:
                runs.append(read_run(path.parent))
            except TFLabError as error:
                damaged.append(f"left out: {error}")
    if not runs:
        names = ", ".join(str(folder) for folder in folders)
        cures = damaged or [_what_to_do(folders)]
        raise TFLabError("; ".join([f"no finished run in {names}", *cures]))
    return runs, damaged


def _what_to_do(folders: Iterable[Path]) -> str:
    """Where no run is finished: wait for what is begun, go on with it, or begin."""
    outputs = dict.fromkeys(output for folder in folders for output in (folder, folder.parent))
    entries = [e for o in outputs for e in (*inventory.find_trainings(o), *inventory.find_runs(o))]
    begun = [entry for entry in entries if entry.state.startswith(inventory.UNFINISHED)]
    if not begun:
        return (
            "run: python -m tf_lab.train (one run, in minutes), or with sweep=main_ablation (the "
            "paper's table, in hours); runs elsewhere are given by runs="
        )
    first = min(begun, key=lambda entry: entry.user is None)
    if first.user:
        return f"{first.directory} is {first.state} ({first.user} works on it): report when it ends"
    command = first.origin.get("command", "the command that began it")
    return f"{first.directory} is {first.state}; it goes on by: {command}"


def read_run(directory: Path) -> Run:
    """A finished run, from its ``config.yaml``, ``metrics.json`` and ``run.json``.

    Raises:
        TFLabError: one of them is missing or damaged, or of a version that had other settings.
    """
    try:
        config = read_config(directory / CONFIG)
    except TFLabError as error:
        raise TFLabError(f"{error}; {_anew(directory / 'config.yaml')}") from error
    cure = _anew(directory / SCORES)
    metrics = read_record(Metrics, directory / SCORES, cure)
    origin = read_record(Origin, directory / ORIGIN, cure)
    training = origin.get("training", Origin())
    settings = _trained_as(config)
    if config.optimizer.steps == 0:  # a network that is only tested: one of each seed
        settings["content"]["init"] = None
        settings |= _init_settings(training)
    settings["test"] = _of_any_row(evaluation_identity(config))
    settings["test"]["protocol"] = metrics.protocol
    settings["test"]["scenes"] = sorted(metrics.scenes)
    return Run(
        directory,
        row_label(config),
        config.seed,
        config,
        _flat(settings),
        {scene: told_apart(scores, config.metrics) for scene, scores in metrics.scenes.items()},
        (origin, training, *sessions_of(training)),
        (directory / SCORES).stat().st_mtime,
        _view_sets(metrics),
    )


def _of_any_row(identity: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in identity.items() if key not in ROW_SETTINGS}


def _init_settings(training: Origin) -> dict[str, Any]:
    """How the network that ``init`` names was trained; nothing if that is not known."""
    try:
        config = stored_config(training["init"]["config"], "init")
    except (KeyError, TFLabError):  # of a version that did not keep it, or had other settings
        return {}
    settings = _trained_as(config)
    settings["content"]["init"] = None
    return {"init": settings}


def _trained_as(config: TrainConfig) -> dict[str, Any]:
    """What shapes the weights of all rows of a study."""
    settings = _of_any_row(training_identity(config))
    # which stereo there is, the row says with its inputs
    settings["content"] = {k: v for k, v in settings["content"].items() if k != "stereo"}
    weights = config.encoder.weights
    if "weights" not in settings["encoder"] and not Path(weights).suffix:  # ours: no file's name
        settings["encoder"] = {**settings["encoder"], "weights": weights}
    return settings


def told_apart(scores: Scores, metrics: Mapping[str, Any]) -> Scores:
    """Scores, those by other settings of a metric than its defaults under a name that says so."""
    changed = {name: changed_settings(settings) for name, settings in metrics.items()}
    names = {name: f"{name} ({', '.join(each)})" for name, each in changed.items() if each}
    return {names.get(name, name): score for name, score in scores.items()}


def _view_sets(metrics: Metrics) -> dict[str, float]:
    """The means over scenes; nothing where a scene does not say."""
    found = [metrics.details.get(scene, {}).get("view_sets") or {} for scene in metrics.scenes]
    alike = bool(found) and all(each.keys() == found[0].keys() for each in found)
    return mean_scores(found) if alike else {}


def _anew(path: Path) -> str:
    return f"to make it anew: {removal(path.parent)}"


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings by their dotted names."""
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def keep_run(run: Run, folder: Path) -> Path:
    """Copy a run's small files to ``folder/<its name>``, without the paths of this machine.

    Meshes and pictures stay behind; what is kept is what `read_run` needs. ``metrics.json`` comes
    last, as in the run itself.
    """
    kept = folder / run.directory.name
    if kept.resolve() == run.directory.resolve():
        return kept
    write_config(run.config, kept / CONFIG, portable=True)
    for name in (ORIGIN, SCORES):
        write_json(
            kept / name,
            without_places(read_json(run.directory / name, _anew(run.directory / name))),
        )
    return kept
