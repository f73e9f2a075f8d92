"""What all commands share: where the configs are, how errors are shown, which machine this is."""

from __future__ import annotations

import argparse
import functools
import logging
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

import hydra
import torch
from hydra._internal.utils import get_args_parser
from hydra.errors import CompactHydraException, HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from tf_lab.cli import overrides, text_settings
from tf_lab.cli.help import help_text
from tf_lab.errors import TFLabError


class FailedJob(CompactHydraException):
    """A job of a sweep failed; Hydra ends the sweep with the message, and without a traceback."""


def conf_dir() -> str:
    """The directory of the shipped configs: inside an installed wheel, or beside ``src``."""
    package = Path(__file__).resolve().parents[1]
    for candidate in (package / "conf", package.parent.parent / "conf"):
        if candidate.is_dir():
            return str(candidate)
    raise TFLabError("conf/: the configs are missing; install tf_lab again")


def command(
    config_name: str,
    unused: Sequence[str] = (),
    before: Callable[[argparse.Namespace], None] = lambda words: None,
    goes_on: bool = False,
) -> Callable[[Callable[[DictConfig], None]], Callable[[], Any]]:
    """`hydra.main` on the shipped configs, with every error as one line and exit status 2.

    A traceback is printed as well if the environment has ``TF_LAB_DEBUG=1``.

    Args:
        config_name: of the root config.
        unused: settings (or groups of them) of its groups that the command does not read.
        before: checks on the command line what Hydra would not say in one line.
        goes_on: an interrupted command, given again, goes on where it was.
    """

    def decorate(function: Callable[[DictConfig], None]) -> Callable[[], Any]:
        @functools.wraps(function)
        def guarded(cfg: DictConfig) -> None:
            _quieten()
            try:
                if not in_sweep():  # else each job does
                    overrides.check(cfg, unused)
                text_settings.settle(cfg)
                function(cfg)
            except (TFLabError, OmegaConfBaseException, OSError) as error:
                _tell(_one_line(error, function))
                if in_sweep():
                    raise FailedJob("a job of the sweep failed, see above") from None
                sys.exit(2)
            except KeyboardInterrupt:
                more = "; the same command goes on from here" if goes_on else ""
                print(f"\ninterrupted{more}", file=sys.stderr)
                sys.exit(130)

        wrapped = hydra.main(version_base="1.3", config_path=conf_dir(), config_name=config_name)
        run = wrapped(guarded)

        @functools.wraps(function)
        def start() -> None:
            os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises its errors instead of printing them
            try:
                words = _words()
                if words.help:
                    about = sys.modules[function.__module__].__doc__ or ""
                    conf = Path(conf_dir())
                    print(help_text(conf, config_name, about, words.overrides, unused))
                else:
                    overrides.check_groups(words.overrides, Path(conf_dir()))
                    before(words)
                    run()
            except (HydraException, OmegaConfBaseException, TFLabError) as error:
                _tell(overrides.explain(error, Path(conf_dir()), config_name))
                sys.exit(2)
            except BrokenPipeError:  # whoever reads has seen enough
                os._exit(1)

        return start

    return decorate


def _words() -> argparse.Namespace:
    """The command line, from here on with its texts quoted for Hydra.

    Raises:
        TFLabError: it has an option that there is not, or an empty text.
    """
    parser = get_args_parser()

    def error(message: str) -> NoReturn:
        raise TFLabError(f"{message}; settings are NAME=VALUE, --help lists them")

    parser.error = error  # type: ignore[method-assign]
    words = parser.parse_args()
    quoted = text_settings.quote_words(words.overrides, overrides.is_sweep(words))
    sys.argv = [sys.argv[0], *(quoted.get(word, word) for word in sys.argv[1:])]
    return parser.parse_args()


def _tell(line: str) -> None:
    """Print the error that is being handled; raise it again where someone debugs."""
    if os.environ.get("TF_LAB_DEBUG") == "1":
        raise
    print(f"error: {line}", file=sys.stderr)


def _one_line(error: Exception, function: Callable[[DictConfig], None]) -> str:
    """What the user of a command needs to know of an error."""
    line = str(error)
    if isinstance(error, MissingMandatoryValue):
        lines = (sys.modules[function.__module__].__doc__ or "").splitlines()
        usage = next((line for line in lines if line.startswith("python -m")), "")
        given = f"{error.full_key}="
        cure = f"usage: {usage}" if given in usage else f"give {given}VALUE"
        line = f"{error.full_key} is missing; {cure}"
    if "Original Traceback" in line:  # raised in a loader process
        line = line.rpartition(f"{type(error).__name__}: ")[2]
    return " ".join(line.split())


def _quieten() -> None:
    """Keep libraries' advertisements and their remarks on our own choices off the screen."""
    for chatty in ("lightning.pytorch", "fontTools"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    for message in (
        ".*isinstance.treespec, LeafSpec.*",
        ".*Checkpoint directory .* exists and is not empty.*",
        ".*does not have many workers.*",
        ".*in eval mode at the start of training.*",
        ".*Experiment logs directory .* exists and is not empty.*",
        ".*The dirpath has changed from .*",  # a training goes on from another's state
    ):
        warnings.filterwarnings("ignore", message=message)


def in_sweep() -> bool:
    """Whether this is one job of several: then an error must not end the others."""
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode

    return HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN


def plain(cfg: Any) -> Any:
    """A resolved config as plain dicts and lists.

    Raises:
        MissingMandatoryValue: the user has to give a value and did not.
    """
    return OmegaConf.to_container(cfg, resolve=True, throw_on_missing=True)


def device_of(name: str) -> torch.device:
    """The device called "auto" (CUDA where there is one), "cpu" or "cuda".

    Raises:
        TFLabError: it is not there.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name == "cuda" and not torch.cuda.is_available():
        raise TFLabError("device=cuda: torch sees no CUDA device; use device=cpu")
    try:
        return torch.device(name)
    except RuntimeError:
        raise TFLabError(f"device={name}: choose auto, cpu or cuda") from None
