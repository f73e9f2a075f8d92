"""The jobs of a sweep: each that has work to do is a process of its own; a table ends the sweep.

So a job that crashes or runs out of memory ends alone, memory is freed between jobs, and a job may
itself be several processes (DDP).
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from hydra.conf import HydraConf
from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf

from tf_lab.cli.overrides import JOB, task_words
from tf_lab.errors import TFLabError
from tf_lab.evaluation.scores import read_metrics
from tf_lab.experiments.gpus import one_gpu
from tf_lab.experiments.reuse import say_reused
from tf_lab.support.files import write_json
from tf_lab.support.processes import end_with

PARENT = "TF_LAB_PARENT"  # the process that waits for this one
RECORD = "job.json"
LAUNCHERS = {
    "local": "hydra-joblib-launcher",
    "slurm": "hydra-submitit-launcher",
    "ray": "hydra-ray-launcher",
}


def check_launcher(words: argparse.Namespace) -> None:
    """That the command line asks for one sweep at most, and for a launcher that works here.

    Raises:
        TFLabError: it does not.
    """
    for word in words.overrides:
        if word.startswith("sweep=") and "," in word:
            raise TFLabError(f"{word}: one sweep at a time; sweep=all has every row")
    for name, package in LAUNCHERS.items():
        if f"launcher={name}" in words.overrides:
            try:
                importlib.metadata.version(package)
            except importlib.metadata.PackageNotFoundError:
                message = f"launcher={name} needs a package more: pip install {package}"
                raise TFLabError(message) from None
    starts = words.cfg is None and JOB not in words.overrides  # a job may see no srun
    if starts and "launcher=slurm" in words.overrides and shutil.which("srun") is None:
        raise TFLabError(
            "launcher=slurm: there is no srun here; start it on the cluster's login node"
        )


def run_job(module: str, row: str, seed: int, find: Callable[[], Path | None]) -> None:
    """Do one job of a sweep, unless it is done; record how it ended instead of raising.

    Args:
        module: whose command line does the job.
        row: what the job is, for the table.
        seed: of the job, for the table.
        find: the directory of the job's finished evaluation, if it is there.
    """
    if multiprocessing.current_process().name != "MainProcess":  # a launcher's worker
        end_with(os.getppid())
    hydra = HydraConfig.get()
    folder = Path(hydra.runtime.output_dir)
    log = folder / "log.txt"
    record: dict[str, Any] = {"job": hydra.job.num, "row": row, "seed": seed}
    run = find()
    if run is not None:
        say_reused("evaluation", run)
    else:
        record["log"] = str(log)
        write_json(folder / RECORD, {**record, "failed": "ended with the sweep"})
        print(f"job {hydra.job.num}: {row}, seed {seed}; log: {log}", flush=True)
        alone = hydra.launcher._target_.endswith(".BasicLauncher")
        prefix = "" if alone else f"{hydra.job.num}: "
        with one_gpu() if _shares_gpus(hydra) else nullcontext():
            status = _run([sys.executable, "-m", module, *single_run(hydra)], log, prefix)
        run = find()
        if status != 0 or run is None:
            record["failed"] = _reason(status)
    metrics = read_metrics(run) if run is not None else None
    write_json(folder / RECORD, {**record, "fscore": metrics and metrics["mean"]["fscore"]})


def _shares_gpus(hydra: Any) -> bool:
    """Whether jobs run side by side on one machine, and each on one device."""
    devices = OmegaConf.select(hydra, "..trainer.devices")  # of the whole config
    return hydra.launcher._target_.endswith(".JoblibLauncher") and devices == 1


def single_run(hydra: HydraConf) -> list[str]:
    """The command line that does a job of a sweep alone."""
    sources = [s for s in hydra.runtime.config_sources if s.provider == "command-line"]
    overrides = [o for o in hydra.overrides.hydra if not o.startswith("hydra.mode=")]
    return [
        *(f"--config-dir={source.path}" for source in sources),
        *overrides,
        *task_words(hydra),
        JOB,
    ]


def _run(command: Sequence[str], log: Path, prefix: str) -> int:
    """Run a process; its output goes to the log and, with a prefix, to the screen."""
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", PARENT: str(os.getpid())}
    with (
        log.open("w") as file,
        subprocess.Popen(
            command,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        ) as process,
    ):
        try:
            assert process.stdout is not None
            for line in process.stdout:
                print(line, end="", file=file, flush=True)
                print(prefix + line, end="", flush=True)
        except BaseException:  # interrupted: the process must not go on alone
            process.terminate()
            raise
    return process.returncode


def _reason(status: int) -> str:
    if status < 0:
        return f"killed by {signal.Signals(-status).name}"
    return f"exit status {status}" if status else "left no result"


def end_with_parent() -> None:
    """End this process as soon as the sweep that started it is gone, even if that was killed."""
    parent = os.environ.pop(PARENT, None)  # helpers of a distributed training have another
    if parent is not None:
        end_with(int(parent))


class JobTable(Callback):
    """Ends a sweep with a table of its jobs, and with exit status 1 if any failed."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Print the table."""
        records = [
            json.loads(path.read_text())
            for path in Path(config.hydra.sweep.dir).glob(f"*/{RECORD}")
        ]
        records.sort(key=lambda record: record["job"])
        print(f"\n{format_jobs(records)}", flush=True)
        if any("failed" in record for record in records):
            sys.exit(1)


def format_jobs(records: Sequence[Mapping[str, Any]]) -> str:
    """The jobs of a sweep as aligned text: row, seed, and F-score or why and where it failed."""
    width = max([3, *(len(record["row"]) for record in records)])
    lines = [f"job  {'row'.ljust(width)}  seed  F-score"]
    for r in records:
        result = f"failed: {r['failed']}, see {r['log']}" if "failed" in r else f"{r['fscore']:.3f}"
        lines.append(f"{r['job']:>3}  {r['row'].ljust(width)}  {r['seed']:>4}  {result}")
    failed = sum("failed" in record for record in records)
    if failed:
        lines.append(f"{failed} of {len(records)} jobs failed; the same command tries them again")
    return "\n".join(lines)
