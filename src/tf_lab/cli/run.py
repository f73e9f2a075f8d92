"""What all commands do: compose their config by Hydra, hand it on typed, show errors as a line."""

from __future__ import annotations

import argparse
import logging
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NoReturn

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException, HydraException
from omegaconf import DictConfig
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from tf_lab.cli import overrides
from tf_lab.cli.help import help_text
from tf_lab.config.compose import conf_dir
from tf_lab.config.registration import register
from tf_lab.config.schema import CONFIGS
from tf_lab.config.text_settings import Texts, quote_overrides
from tf_lab.config.typed import typed
from tf_lab.errors import TFLabError
from tf_lab.experiments.launcher import check_launcher, in_sweep, run_job
from tf_lab.support.processes import Children


class FailedJob(CompactHydraException):
    """A job of a sweep failed; Hydra ends the sweep with the message, and without a traceback."""


def run_command(name: str, about: str, target: str, unused: Sequence[str], jobs: str) -> None:
    """Do what the command line asks for; see `tf_lab.cli.command`."""

    def composed(cfg: DictConfig) -> None:
        try:
            if not in_sweep():  # else each job does
                instead: Mapping[str, Sequence[str]] = getattr(CONFIGS[name], "replaced", {})
                used = {key: names for key, names in instead.items() if cfg.get(key) is not None}
                overrides.check(unused, used)
            config: Any = typed(CONFIGS[name], cfg)
            if jobs and in_sweep():  # in a worker of Slurm or Ray
                job = HydraConfig.get()
                run_job(resolve_name(jobs), config, job, Children(), prefix=f"{job.job.num}: ")
                return
            work = resolve_name(target)
            _quieten()  # after the import, with which libraries set themselves up
            work(config)
        except (TFLabError, OmegaConfBaseException, OSError) as error:
            _tell(_one_line(error, about))
            if in_sweep():
                raise FailedJob("a job of the sweep failed, see above") from None
            sys.exit(2)

    composed.jobs = jobs  # type: ignore[attr-defined]  # for the launcher
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises its errors instead of printing them
    conf, given = conf_dir(), argparse.Namespace(overrides=[])
    try:
        register()
        given = _command_line(CONFIGS[name])
        if given.help:
            own = given.config_dir
            print(help_text(conf, name, about, given.overrides, unused, own))
        else:
            overrides.check_groups(given.overrides, conf)
            check_launcher(given)
            hydra.main(version_base="1.3", config_path=str(conf), config_name=name)(composed)()
    except (HydraException, OmegaConfBaseException, TFLabError) as error:
        own = getattr(given, "config_dir", None)
        _tell(overrides.explain(error, conf, name, given.overrides, own))
        sys.exit(2)
    except BrokenPipeError:  # whoever reads has seen enough
        os._exit(1)
    except OSError as error:  # of a sweep's folder, which Hydra makes
        _tell(f"{error.filename}: {error.strerror}; give another place by output=")
        sys.exit(2)


def _command_line(schema: type) -> argparse.Namespace:
    """The command line, from here on with its options first and its texts quoted for Hydra.

    Raises:
        TFLabError: it has an option that there is not, or an empty text.
    """
    parser = get_args_parser()

    def error(message: str) -> NoReturn:
        raise TFLabError(f"{message}; settings are NAME=VALUE, --help lists them")

    parser.error = error  # type: ignore[method-assign]
    given = parser.parse_intermixed_args()
    asked = [f"--{name}" for name in ("run", "multirun", "cfg", "info") if getattr(given, name)]
    if len(asked) > 1 and not given.help:
        error(f"{' and '.join(asked)}: one of them at a time")
    if given.experimental_rerun is not None and not Path(given.experimental_rerun).is_file():
        error(f"--experimental-rerun {given.experimental_rerun}: no such file")
    quoted = quote_overrides(given.overrides, Texts.of(schema), overrides.is_sweep(given))
    options = [word for word in sys.argv[1:] if word not in given.overrides]
    sys.argv = [sys.argv[0], *options, *(quoted.get(word, word) for word in given.overrides)]
    return parser.parse_args()


def _tell(line: str) -> None:
    """Print the error that is being handled; raise it again where someone debugs."""
    if os.environ.get("TF_LAB_DEBUG") == "1":
        raise
    print(f"error: {line}", file=sys.stderr)


def _one_line(error: Exception, about: str) -> str:
    """What the user of a command needs to know of an error."""
    line = str(error)
    if isinstance(error, MissingMandatoryValue):
        lines = about.splitlines()
        usage = next((line for line in lines if line.startswith("python -m")), "")
        given = f"{error.full_key}="
        cure = f"usage: {usage}" if given in usage else f"give {given}VALUE"
        line = f"{error.full_key} is missing; {cure}"
    if "Original Traceback" in line:  # raised in a loader process
        line = line.rpartition(f"{type(error).__name__}: ")[2]
    return " ".join(line.split())


def _quieten() -> None:
    """Keep libraries' advertisements and their remarks on our own choices off the screen."""
    for chatty in ("lightning.pytorch", "fontTools", "matplotlib.font_manager"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    for message in (
        ".*isinstance.treespec, LeafSpec.*",
        ".*Checkpoint directory .* exists and is not empty.*",
        ".*does not have many workers.*",
        ".*Our suggested max number of worker.*",
        ".*in eval mode at the start of training.*",
        ".*Experiment logs directory .* exists and is not empty.*",
        ".*The dirpath has changed from .*",  # a training goes on from another's state
    ):
        warnings.filterwarnings("ignore", message=message)
