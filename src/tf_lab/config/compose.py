"""Composing a command's config outside the command line, as in a notebook or a test."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from tf_lab.config.registration import register
from tf_lab.config.schema import CONFIGS
from tf_lab.config.text_settings import Texts, quote_overrides
from tf_lab.config.typed import typed
from tf_lab.errors import TFLabError


def conf_dir() -> Path:
    """The directory of the shipped configs: inside an installed wheel, or beside ``src``."""
    package = Path(__file__).resolve().parents[1]
    for candidate in (package / "conf", package.parents[1] / "conf"):
        if candidate.is_dir():
            return candidate
    raise TFLabError("conf/: the configs are missing; install tf_lab again")


def compose_config(command: str, *overrides: str) -> Any:
    """The typed config of a command with settings as on its command line (without a shell).

    Raises:
        TFLabError: a text is empty, or a number out of its range.
    """
    return typed(CONFIGS[command], compose_hydra(command, *overrides))


def compose_hydra(command: str, *overrides: str) -> DictConfig:
    """The same as Hydra composes it."""
    register()
    quoted = quote_overrides(overrides, Texts.of(CONFIGS[command]), sweeps=False)
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        return compose(command, [quoted[word] for word in overrides])
