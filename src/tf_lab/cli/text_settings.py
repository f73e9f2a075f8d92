"""Settings that are text, whatever they look like: paths and names.

Hydra reads ``input=2024_01_01`` as a number and ``input=true`` as a truth value, and takes ``=``,
``,`` or ``(1)`` in a path for its own grammar. So the words of these settings are quoted for it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from tf_lab.errors import TFLabError

PATHS = (  # in which ~ is expanded
    *("input", "checkpoint", "output", "predictions", "groundtruth", "runs", "shards"),
    *("data.root", "data.scenes", "data.urls", "data.train", "data.val", "data.test"),
    *("encoder.weights", "init", "real"),
)
NAMES = ("format", "data.format", "model.name", "logger.project", "study")
LISTS = ("runs", "data.urls", "data.train", "data.val", "data.test")  # one text, or [several]
NEVER_SWEPT = ("output",)  # of the others, commas separate values in a sweep

_QUOTED = r"""(?:"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*')"""
_GROUP = r"(?:\{[^{}]*\}|\[(?:[^\[\]]|\[[^\[\]]*\])*\])"  # its commas separate nothing
_PART = rf"(?s)\s*(?:{_QUOTED}\s*(?=,|$)|(?:{_GROUP}|[^,])+)"
_CHOICE = r"(?s)(?:choice|shuffle|sort|tag)\(.*\)"  # Hydra's functions for sweeps


def quote_words(words: Sequence[str], sweeps: bool) -> dict[str, str]:
    """The settings of a command line as Hydra has to read them, by what was given.

    Args:
        words: ``NAME=VALUE``.
        sweeps: whether commas separate values of several jobs.

    Raises:
        TFLabError: a text is empty.
    """
    return {word: _quote_word(word, sweeps) for word in words}


def _quote_word(word: str, sweeps: bool) -> str:
    """``NAME=VALUE`` so that Hydra takes the value as it stands, if the setting is a text."""
    match = re.fullmatch(r"(?s)(\+{0,2}([\w.]+)=)(.*)", word)
    if match is None or match[2] not in (*PATHS, *NAMES):
        return word
    start, name, value = match.groups()
    if not value.strip():
        raise TFLabError(f"{word}: is empty; give {name}=VALUE, or leave it out")
    sweeps = sweeps and name not in NEVER_SWEPT
    if sweeps and re.fullmatch(_CHOICE, value):
        return word
    parts = _split(value)
    if (sweeps or name in LISTS) and len(parts) > 1 and not os.path.exists(expand(value)):  # noqa: PTH110
        return start + ",".join(_quote(part, name) for part in parts)  # without -m, Hydra complains
    return start + _quote(value, name)


def _quote(value: str, name: str) -> str:
    """The value of a setting for Hydra: null, a list of texts, or a text."""
    if value == "null":
        return value
    if name in LISTS and value.startswith("[") and value.endswith("]"):
        return f"[{','.join(map(_quote_text, _split(value[1:-1])))}]"
    return _quote_text(value)


def _quote_text(value: str) -> str:
    """A text for Hydra's grammar; one that is quoted for it already stays as it is."""
    if re.fullmatch(rf"(?s){_QUOTED}", value):
        return value
    try:
        override = OverridesParser.create().parse_override(f"x={value}")
        if "${" not in value and override.value() == value and not override.is_sweep_override():
            return value
    except HydraException:
        pass
    return QuotedString(_literal(value), Quote.single).with_quotes()


def _split(value: str) -> list[str]:
    """The parts between commas, without the blanks around them."""
    return [part.strip() for part in re.findall(_PART, value) if part.strip()]


def _literal(value: str) -> str:
    """The value for OmegaConf, which would replace ``${...}`` by a setting's value."""
    return re.sub(r"(\\*)\$\{", r"\1\1\\${", value)


def expand(path: str) -> str:
    """The path with its ``~`` as a folder; pathlib's way fails where there is no such user."""
    return os.path.expanduser(path)  # noqa: PTH111


def settle(cfg: DictConfig) -> None:
    """Expand ``~`` in the paths of a composed config, in place, wherever they come from.

    Raises:
        TFLabError: a text is something else, as only a file can say (2024_01_01 without quotes).
    """
    for name in (*PATHS, *NAMES):
        value = value_of(cfg, name)
        several = isinstance(value, ListConfig) and name in LISTS
        texts = list(value) if several else [value]
        for text in texts:
            if text is not None and not isinstance(text, str):
                raise TFLabError(f'{name}={text}: must be text; put it in quotes, "{text}"')
        if name in PATHS and any(text and text.startswith("~") for text in texts):
            expanded = [_literal(expand(text)) for text in texts]
            OmegaConf.update(cfg, name, expanded if several else expanded[0])


def value_of(cfg: DictConfig, name: str) -> Any:
    """Of a setting; None: there is none, or it is made of another one that is missing."""
    try:
        return OmegaConf.select(cfg, name)
    except OmegaConfBaseException:
        return None
