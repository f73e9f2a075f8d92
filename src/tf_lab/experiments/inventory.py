"""What trainings and evaluations lie in an output folder, and in which state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from tf_lab.config.schema import TrainConfig
from tf_lab.config.stored import read_config
from tf_lab.errors import TFLabError
from tf_lab.evaluation.scores import read_metrics
from tf_lab.experiments.identity import row_label
from tf_lab.experiments.provenance import Origin
from tf_lab.experiments.reuse import origin_of, saved_state
from tf_lab.support.layout import CONFIG, LAST, ORIGIN, RUNS, SCORES, TRAININGS, WEIGHTS
from tf_lab.support.locks import lock_holder
from tf_lab.support.records import record

T = TypeVar("T")
UNFINISHED = "unfinished"


@dataclass(frozen=True)
class Entry:
    """A training or an evaluation.

    Attributes:
        directory: where it lies.
        state: "finished", "damaged", or `UNFINISHED`, of a training with how far it is.
        user: the process that works on it; None: nobody.
        config: its config; None if that cannot be read.
        origin: its provenance, of an unfinished one as far as it is known.
        fscore: of a finished evaluation that has one.
        problems: one line on each of its files that cannot be read.
    """

    directory: Path
    state: str
    user: str | None
    config: TrainConfig | None
    origin: Origin
    fscore: float | None = None
    problems: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """The row of the paper's tables and the seed, and what else than its data is tested on."""
        if self.config is None:
            return "?"
        elsewhere = "" if self.config.test_on is None else f" on {self.config.test_on.name}"
        return f"{row_label(self.config)} / {self.config.seed}{elsewhere}"

    @property
    def training(self) -> str | None:
        """The name of the training that an evaluation is of."""
        checkpoint = self.origin.get("checkpoint")
        return Path(checkpoint).parent.name if checkpoint else None


def find_trainings(output: Path) -> list[Entry]:
    """All trainings of an output folder."""
    return [_training(path) for path in _folders(output / TRAININGS)]


def find_runs(output: Path) -> list[Entry]:
    """All evaluations of an output folder."""
    return [_run(path) for path in _folders(output / RUNS)]


def _folders(parent: Path) -> list[Path]:
    """Those that hold something; one that was killed before it began has a lock only."""
    found = parent.iterdir() if parent.is_dir() else ()
    folders = (path for path in found if path.is_dir() and not path.name.startswith("."))
    return sorted(f for f in folders if any(not p.name.startswith(".") for p in f.iterdir()))


def _training(directory: Path) -> Entry:
    problems: list[str] = []
    config = _read(read_config, directory / CONFIG, problems)
    origin: Origin = {}
    last = directory / LAST
    try:
        if (directory / WEIGHTS).exists():
            state, origin = "finished", origin_of(directory)
        else:
            state, origin = UNFINISHED, _begun(directory, problems)
        if state == UNFINISHED and last.exists():
            saved = saved_state(last)
            steps = config.optimizer.steps if config else "?"  # of another version
            state += f" at step {saved['global_step']} of {steps}"
            origin |= _so_far(saved)
    except Exception as error:  # any damage
        state = "damaged"
        problems.append(str(error) if isinstance(error, TFLabError) else f"{last}: damaged")
    return Entry(directory, state, lock_holder(directory), config, origin, problems=tuple(problems))


def _so_far(saved: Mapping[str, Any]) -> Origin:
    """Which code worked on a training until its last checkpoint, and how long."""
    kept = saved.get("callbacks", {}).get("TrainingSessions", {})
    sessions = record(list[Origin], kept.get("sessions", []), "sessions")
    seconds = [each["seconds"] or 0 for each in sessions if "seconds" in each]
    return Origin(sessions=sessions, seconds=sum(seconds)) if sessions else Origin()


def _begun(directory: Path, problems: list[str]) -> Origin:
    """The provenance that is written when work begins."""
    return _read(lambda path: origin_of(path.parent), directory / ORIGIN, problems) or {}


def _run(directory: Path) -> Entry:
    problems: list[str] = []
    config = _read(read_config, directory / CONFIG, problems)
    bad = len(problems)  # of which a run of another version is none the worse
    origin = _begun(directory, problems)
    metrics = _read(lambda path: read_metrics(path.parent), directory / SCORES, problems)
    state = "damaged" if problems[bad:] else "finished" if metrics and origin else UNFINISHED
    fscore = metrics.mean.get("fscore") if metrics else None
    user = lock_holder(directory)
    return Entry(directory, state, user, config, origin, fscore, tuple(problems))


def _read(read: Callable[[Path], T], path: Path, problems: list[str]) -> T | None:
    """What a file holds; None where it is missing, or damaged, which ``problems`` then says."""
    if not path.exists():
        return None
    try:
        return read(path)
    except TFLabError as error:
        problems.append(str(error))
        return None


def find(output: Path, name: str) -> Entry:
    """The training or evaluation of a name, of a key (the name's end), or in a directory.

    Args:
        output: where to look for it, unless it is a directory of another output folder.
        name: of it.

    Raises:
        TFLabError: there is none, or more than one.
    """
    output = _output_of(name) or output
    entries = [*find_trainings(output), *find_runs(output)]
    directory = Path(name).resolve()
    found = [e for e in entries if e.directory.resolve() == directory or e.directory.name == name]
    found = found or [e for e in entries if e.directory.name.endswith(f"-{name}")]
    if len(found) != 1:
        several = "more than one is" if found else "no training or evaluation is"
        there = f"python -m tf_lab.runs output={output}"
        raise TFLabError(f"{name}: {several} called so in {output}; see {there}")
    return found[0]


def _output_of(name: str) -> Path | None:
    """The output folder that a training or an evaluation lies in, if that is what the path is."""
    for path in (Path(name), Path(name).resolve()):
        if path.is_dir() and path.parent.name in (TRAININGS, RUNS):
            return path.parents[1]
    return None


def with_dependents(entry: Entry) -> list[Path]:
    """The directories that go with it: a training and its evaluations, or an evaluation.

    Raises:
        TFLabError: one is in use.
    """
    runs = find_runs(entry.directory.parents[1])
    dependent = [run for run in runs if run.training == entry.directory.name]
    for each in (entry, *dependent):
        if each.user:
            raise TFLabError(f"{each.directory}: {each.user} works on it; end that first")
    return [*(run.directory for run in dependent), entry.directory]
