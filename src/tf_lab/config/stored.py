"""Configs in files: written beside a run, read again by this version or a later one."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import yaml
from omegaconf.errors import OmegaConfBaseException

from tf_lab.config.schema import GROUPS, TrainConfig
from tf_lab.config.typed import literal, typed
from tf_lab.errors import TFLabError
from tf_lab.network.encoders import ENCODERS
from tf_lab.support.documents import read_yaml
from tf_lab.support.files import write_text
from tf_lab.support.records import record
from tf_lab.support.settings import absent_values

_MISTAKES = (KeyError, TypeError, ValueError, AttributeError)  # of values that are others


def write_config(config: TrainConfig, path: Path, portable: bool = False) -> None:
    """Save a config; its scenes, which may be many, are in ``run.json``."""
    values = portable_config(config) if portable else _plain(config)
    write_text(path, yaml.safe_dump(values, sort_keys=False))


def portable_config(config: Any) -> dict[str, Any]:
    """A config as it may travel with a checkpoint: without the paths of this machine."""
    return _plain(config, without_paths=True)


def _plain(settings: Any, without_paths: bool = False) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    for field in fields(settings):
        value = getattr(settings, field.name)
        if isinstance(value, dict) and any(map(is_dataclass, value.values())):
            value = {name: _plain(part, without_paths) for name, part in value.items()}
        if is_dataclass(value):
            plain[field.name] = _plain(value, without_paths)
        elif not (without_paths and field.metadata.get("kind") == "path"):
            plain[field.name] = list(value) if isinstance(value, tuple) else value
    if "scenes" in plain.get("content", {}):
        del plain["content"]["scenes"]
    return plain


def read_config(path: Path) -> TrainConfig:
    """The config of a training or a run, of this version or an older one.

    Raises:
        TFLabError: it is missing, damaged, or of a version that had other settings.
    """
    return stored_config(read_yaml(path, "the settings of a run"), str(path))


def stored_config(values: Any, where: str) -> TrainConfig:
    """A config from the values that `portable_config` gave, in this version or an older one.

    Raises:
        TFLabError: they are damaged, or of a version that had other settings; it begins with
            ``where``.
    """
    try:
        values = record(dict[str, Any], values)
        return typed(TrainConfig, _as_it_stands(_with_places(upgraded(values))))
    except (OmegaConfBaseException, TFLabError, *_MISTAKES) as error:
        reason = str(error).splitlines()[0]
        raise TFLabError(f"{where}: has other settings than this version ({reason})") from error


def upgraded(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of an older version's config as this version has them."""
    new = copy.deepcopy(dict(values))
    data, training = new["data"], new["training"]
    if "version" in data:
        new["content"] = {"versions": data.pop("version")}
    encoder = {"name": "resnet", **new["encoder"]}
    new["encoder"] = {**absent_values(ENCODERS[encoder["name"]].settings), **encoder}
    for group in ("logger", "launcher"):  # shape nothing, and had other settings
        new.pop(group, None)
    if "ranked" in training:  # the share of steps whose views were kept by attention
        share = training.pop("ranked")
        training["rules"] = {"attention": share, "random": 1 - share}
        training["seen_by"] = training["images"]
    return new


def _with_places(values: dict[str, Any]) -> dict[str, Any]:
    """The values with empty paths where a portable config has none."""
    for group, parts in GROUPS.items():
        chosen = values.get(group) or {}
        for field in fields(parts[chosen[parts.key]].settings) if chosen else ():
            if field.metadata.get("kind") == "path" and not field.metadata["several"]:
                chosen.setdefault(field.name, "")
    return values


def _as_it_stands(value: Any) -> Any:
    """Values in which OmegaConf replaces nothing: what is stored is resolved."""
    if isinstance(value, dict):
        return {key: _as_it_stands(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_as_it_stands(item) for item in value]
    return literal(value) if isinstance(value, str) else value
