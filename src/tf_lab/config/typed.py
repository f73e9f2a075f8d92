"""From composed or stored values to the typed config: the one place where dicts end."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import Field, fields, is_dataclass
from typing import Any, TypeVar

from omegaconf import DictConfig, ListConfig, OmegaConf

from tf_lab.config.registration import node_of
from tf_lab.config.schema import GROUPS
from tf_lab.errors import TFLabError
from tf_lab.evaluation.registry import METRICS
from tf_lab.support.settings import check_ranges

T = TypeVar("T")


def typed(schema: type[T], values: DictConfig | Mapping[str, Any]) -> T:
    """Nested values as the dataclass of a command.

    Raises:
        OmegaConfBaseException: an unknown setting, one that is missing, or a value of a wrong type.
        TFLabError: a part that is not there, a number out of its range, or a path that is no text.
    """
    given = values if isinstance(values, DictConfig) else OmegaConf.create(dict(values))
    node = node_of(schema)
    for group, parts in GROUPS.items():
        chosen = OmegaConf.select(given, group, default=None)
        if chosen is None:
            continue
        part, kind = parts[chosen[parts.key]], OmegaConf.get_type(chosen)
        if is_dataclass(kind) and kind is not part.settings:
            there = f"{group}.{parts.key}={part.name}"
            raise TFLabError(f"{there}: choose it by {group}={part.choice}")
        node[group] = node_of(part.settings)
    for name in OmegaConf.select(given, "metrics", default=None) or {}:
        node["metrics"][name] = node_of(METRICS[name].settings)
    merged = OmegaConf.merge(node, given)
    assert isinstance(merged, DictConfig)
    _check_names(merged)
    _expand_paths(merged)
    config = OmegaConf.to_object(merged)
    assert isinstance(config, schema)
    check_ranges(config)
    return config


def _check_names(cfg: DictConfig, prefix: str = "") -> None:
    """That a config has the settings of its schema and no others, and none is missing."""
    kind = OmegaConf.get_type(cfg)
    known = {f.name for f in fields(kind)} if is_dataclass(kind) else {*map(str, cfg)}
    for key in map(str, cfg):
        inner = cfg._get_node(key)
        if key not in known:
            raise TFLabError(f"{prefix}{key}: no such setting; --help lists all")
        if OmegaConf.is_missing(cfg, key):
            OmegaConf.select(cfg, key, throw_on_missing=True)  # raises
        if isinstance(inner, DictConfig) and not inner._is_none():
            _check_names(inner, f"{prefix}{key}.")


def settings_of(cfg: DictConfig, prefix: str = "") -> Iterator[tuple[str, Field[Any]]]:
    """The dotted name and the field of every setting of a config whose nodes are typed."""
    kind = OmegaConf.get_type(cfg)
    known = {f.name: f for f in fields(kind)} if is_dataclass(kind) else {}
    for key in map(str, cfg):
        inner, name = cfg._get_node(key), f"{prefix}{key}"
        if isinstance(inner, DictConfig) and not inner._is_missing() and not inner._is_none():
            yield from settings_of(inner, f"{name}.")
            if not is_dataclass(OmegaConf.get_type(inner)) and key in known:
                yield from ((f"{name}.{item}", known[key]) for item in map(str, inner))
        elif key in known:
            yield name, known[key]


def _expand_paths(cfg: DictConfig) -> None:
    """Expand ``~`` in the paths of a config, in place, wherever they come from."""
    for name, field in list(settings_of(cfg)):
        if field.metadata.get("kind") not in ("path", "source") or OmegaConf.is_missing(cfg, name):
            continue
        value = OmegaConf.select(cfg, name, throw_on_missing=False)
        several = isinstance(value, ListConfig)
        texts = list(value) if several else [value]
        for text in texts:
            if text is not None and not isinstance(text, str):
                raise TFLabError(f'{name}={text}: must be text; put it in quotes, "{text}"')
        if any(text and text.startswith("~") for text in texts):
            expanded = [text and literal(os.path.expanduser(text)) for text in texts]  # noqa: PTH111
            OmegaConf.update(cfg, name, expanded if several else expanded[0])


def literal(text: str) -> str:
    """A text for OmegaConf, which would replace ``${...}`` by a setting's value."""
    return re.sub(r"(\\*)\$\{", r"\1\1\\${", text)
