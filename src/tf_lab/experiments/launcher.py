"""The jobs of a sweep: each that has work to do is a process of its own; a table ends the sweep.

So a job that crashes or runs out of memory ends alone, memory is freed between jobs, and a job may
itself be several processes (DDP). On this machine `hydra_plugins.tf_lab_launcher` runs them; by
Slurm or Ray, each of their workers runs one.
"""

from __future__ import annotations

import argparse
import copy
import importlib.metadata
import json
import os
import shutil
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict, read_write
from omegaconf.errors import OmegaConfBaseException

from tf_lab.config.typed import typed
from tf_lab.errors import TFLabError
from tf_lab.evaluation.scores import read_metrics
from tf_lab.experiments.gpus import one_gpu
from tf_lab.experiments.inventory import RUNS
from tf_lab.experiments.reuse import print_reuse
from tf_lab.support.files import write_json
from tf_lab.support.processes import Children
from tf_lab.support.tables import NOTHING, aligned

JOB = "hydra.mode=RUN"  # in the command line that does one job of a sweep
RECORD = "job.json"
LAUNCHERS = {  # what they need, and what pip calls it
    "slurm": ("hydra-submitit-launcher", "hydra-submitit-launcher"),
    "ray": ("hydra-ray-launcher", "-e '.[ray]'"),
}


@dataclass(frozen=True)
class SweepJobs:
    """What a sweep has to know of the jobs of a command.

    Attributes:
        module: whose command line does a job.
        schema: of a job's config.
        label: the row that a config makes, for the table.
        finished: the directory of a config's evaluation, with its ``metrics.json``; None: it is
            not finished. May raise what is wrong with the config.
    """

    module: str
    schema: type
    label: Callable[[Any], str]
    finished: Callable[[Any], Path | None]


def check_launcher(given: argparse.Namespace) -> None:
    """That the command line asks for one sweep at most, and for a launcher that works here.

    Raises:
        TFLabError: it does not.
    """
    for override in given.overrides:
        if override.startswith("sweep=") and "," in override:
            raise TFLabError(f"{override}: one sweep at a time; sweep=all has every row")
    for name, (package, wanted) in LAUNCHERS.items():
        if f"launcher={name}" in given.overrides:
            try:
                importlib.metadata.version(package)
            except importlib.metadata.PackageNotFoundError:
                raise TFLabError(
                    f"launcher={name} needs {package}: pip install -c constraints.txt {wanted}"
                ) from None
    starts = given.cfg is None and JOB not in given.overrides  # a job may see no srun
    if starts and "launcher=slurm" in given.overrides and shutil.which("srun") is None:
        raise TFLabError(
            "launcher=slurm: there is no srun here; start it on the cluster's login node"
        )


def run_jobs(jobs: SweepJobs, composed: Sequence[DictConfig], at_once: int) -> None:
    """Run the jobs of a sweep; if this is interrupted, they end.

    Args:
        jobs: see `SweepJobs`.
        composed: the config of every job, Hydra's node included.
        at_once: so many, each with its share of the cores and, of several GPUs, with one.

    Raises:
        TFLabError: ``at_once`` is no number of jobs, or a config is wrong.
    """
    if at_once < 1:
        raise TFLabError(f"launcher.jobs={at_once}: must be at least 1")
    configs: list[Any] = [typed(jobs.schema, _without_hydra(cfg)) for cfg in composed]
    work = list(zip(configs, [cfg.hydra for cfg in composed], strict=True))
    children = Children()
    if at_once == 1:
        for config, hydra in work:
            run_job(jobs, config, hydra, children)
        return
    shared = {"OMP_NUM_THREADS": str(max(1, (os.cpu_count() or 1) // at_once)), **os.environ}
    with ThreadPoolExecutor(at_once) as pool:
        try:
            running = [pool.submit(_run_beside, jobs, *job, children, shared) for job in work]
            for future in running:
                future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            children.terminate()
            raise


def _run_beside(
    jobs: SweepJobs, config: Any, hydra: Any, children: Children, shared: Mapping[str, str]
) -> None:
    """Do a job beside others of this machine, whose environment is ``shared``."""
    with one_gpu() if config.trainer.devices == 1 else nullcontext() as gpu:
        variables = {**shared, **(gpu or {})}
        run_job(jobs, config, hydra, children, variables, f"{hydra.job.num}: ")


def _without_hydra(cfg: DictConfig) -> DictConfig:
    """A copy of a config as a command gets it: without Hydra's node."""
    task = copy.deepcopy(cfg)
    with read_write(task), open_dict(task):
        del task["hydra"]
    return task


def run_job(
    jobs: SweepJobs,
    config: Any,
    hydra: Any,
    children: Children,
    variables: Mapping[str, str] | None = None,
    prefix: str = "",
) -> None:
    """Do one job of a sweep, unless it is done; record how it ended instead of raising.

    Args:
        jobs: see `SweepJobs`.
        config: of the job, of the schema.
        hydra: Hydra's config of it.
        children: runs its process.
        variables: the environment of that; None: this one's.
        prefix: of its lines on the screen.
    """
    folder = Path(hydra.sweep.dir).absolute() / str(hydra.sweep.subdir)
    log = folder / "log.txt"
    row, seed = jobs.label(config), config.seed
    record: dict[str, Any] = {"job": hydra.job.num, "row": row, "seed": seed}
    record["settings"] = task_overrides(hydra)
    run = _finished(jobs, config)
    if run is not None:
        print_reuse("evaluation" if run.parent.name == RUNS else "training", run)
    else:
        record["log"] = str(log)
        write_json(folder / RECORD, {**record, "failed": "ended with the sweep"})
        print(f"job {hydra.job.num}: {row}, seed {seed}; log: {log}", flush=True)
        command = [sys.executable, "-m", jobs.module, *single_run(hydra)]
        status = children.run(command, log, os.environ if variables is None else variables, prefix)
        run = _finished(jobs, config)
        if status != 0 or run is None:
            record["failed"] = _reason(status, log)
    metrics = read_metrics(run) if run is not None else None
    write_json(folder / RECORD, {**record, "fscore": metrics and metrics.mean.get("fscore")})


def _finished(jobs: SweepJobs, config: Any) -> Path | None:
    try:
        return jobs.finished(config)
    except (TFLabError, OmegaConfBaseException, OSError):
        return None  # the job's own process says what is wrong


def single_run(hydra: Any) -> list[str]:
    """The command line that does a job of a sweep alone."""
    sources = [s for s in hydra.runtime.config_sources if s.provider == "command-line"]
    given = OmegaConf.to_container(hydra.overrides.hydra, resolve=False)
    assert isinstance(given, list)
    overrides = [o for o in given if not o.startswith(("hydra.mode=", "hydra.sweep."))]
    return [
        *(f"--config-dir={source.path}" for source in sources),
        *overrides,
        *task_overrides(hydra),
        JOB,
    ]


def task_overrides(hydra: Any) -> list[str]:
    """The settings in Hydra's command line, of which nothing is replaced by another's value."""
    given = OmegaConf.to_container(hydra.overrides.task, resolve=False)
    assert isinstance(given, list)
    return [str(override) for override in given]


def _reason(status: int, log: Path) -> str:
    if status < 0:
        return f"killed by {signal.Signals(-status).name}"
    lines = log.read_text(errors="replace").splitlines() if log.exists() else []
    errors = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
    return errors[0] if errors else f"exit status {status}" if status else "left no result"


class JobTable(Callback):
    """Ends a sweep with a table of its jobs, and with exit status 1 if any failed."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Note which records an earlier sweep left in the folder."""
        self._earlier = _records(config)

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Print the table."""
        new = _records(config).items() - self._earlier.items()
        records = [json.loads(path.read_text()) for path, _ in new]
        records.sort(key=lambda record: record["job"])
        print(f"\n{format_jobs(records)}", flush=True)
        if any("failed" in record for record in records):
            sys.exit(1)


def _records(config: DictConfig) -> dict[Path, int]:
    """The records in a sweep's folder, and when they were written."""
    files = Path(config.hydra.sweep.dir).rglob(RECORD)
    return {path: path.stat().st_mtime_ns for path in files}


def format_jobs(records: Sequence[Mapping[str, Any]]) -> str:
    """The jobs of a sweep as aligned text: row, seed, and F-score or why and where it failed.

    Where rows and seeds do not tell jobs apart, the settings do that not all of them have.
    """
    rows, names = [], [(r["row"], r["seed"]) for r in records]
    same = set.intersection(*(set(r.get("settings", ())) for r in records)) if records else set()
    for r in records:
        score = NOTHING if r.get("fscore") is None else f"{r['fscore']:.3f}"
        result = f"failed: {r['failed']}, see {r['log']}" if "failed" in r else score
        differs = [s for s in r.get("settings", ()) if s not in same]
        told = names.count((r["row"], r["seed"])) > 1 and not {*differs} <= {f"seed={r['seed']}"}
        row = f"{r['row']} ({' '.join(differs)})" if told else r["row"]
        rows.append([str(r["job"]), row, str(r["seed"]), result])
    table = aligned(rows, "rlrl", ["job", "row", "seed", "F-score"])
    failed = sum("failed" in record for record in records)
    more = f"\n{failed} of {len(records)} jobs failed; the same command tries them again"
    return table + (more if failed else "")


def in_sweep() -> bool:
    """Whether this is one job of several, in the worker of a launcher."""
    return HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN


def of_this_job(path: Path) -> Path:
    """A file with this job's number in its name, if there are several, which all would write it."""
    return path.with_stem(f"{path.stem}-{HydraConfig.get().job.num}") if in_sweep() else path
