"""Settings that are text, whatever they look like: paths and names.

Hydra reads ``input=2024_01_01`` as a number and ``input=true`` as a truth value, and takes ``=``,
``,`` or ``(1)`` in a path for its own grammar. So the values of these settings are quoted for it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import Field, dataclass, fields, is_dataclass
from typing import Any, get_type_hints

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException

from tf_lab.config.schema import GROUPS
from tf_lab.config.typed import literal
from tf_lab.errors import TFLabError

NEVER_SWEPT = ("output",)  # of the others, commas separate values in a sweep

_QUOTED = r"""(?:"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*')"""
_GROUP = r"(?:\{[^{}]*\}|\[(?:[^\[\]]|\[[^\[\]]*\])*\])"  # its commas separate nothing
_PART = rf"(?s)\s*(?:{_QUOTED}\s*(?=,|$)|(?:{_GROUP}|[^,])+)"
_ESCAPED = r"[\\()\[\]{}:=,\s]"  # what Hydra's sweeper escapes in a text that is not quoted
_CHOICE = r"(?s)(?:choice|shuffle|sort|tag)\(.*\)"  # Hydra's functions for sweeps


@dataclass(frozen=True)
class Texts:
    """Which settings of a command are text, and of these, which may be a list of several."""

    names: frozenset[str]
    lists: frozenset[str]

    @classmethod
    def of(cls, schema: type) -> Texts:
        """Those of a command, whichever parts are chosen."""
        found = dict(_fields(schema))
        lists = frozenset(name for name, field in found.items() if field.metadata.get("several"))
        return cls(frozenset(name for name, field in found.items() if _is_text(field)), lists)


def _fields(schema: Any, prefix: str = "") -> Iterator[tuple[str, Field[Any]]]:
    kinds = get_type_hints(schema)
    for field in fields(schema):
        if is_dataclass(kind := kinds[field.name]):
            yield from _fields(kind, f"{prefix}{field.name}.")
        else:
            yield f"{prefix}{field.name}", field
    for group, parts in GROUPS.items() if not prefix else ():
        if any(field.name == group for field in fields(schema)):
            for part in parts:
                yield from _fields(part.settings, f"{group}.")


def _is_text(field: Field[Any]) -> bool:
    return field.metadata.get("kind", "value") != "value" or str(field.type).startswith("str")


def quote_overrides(overrides: Sequence[str], texts: Texts, sweeps: bool) -> dict[str, str]:
    """The settings of a command line as Hydra has to read them, by what was given.

    Args:
        overrides: ``NAME=VALUE``.
        texts: which are text.
        sweeps: whether commas separate values of several jobs.

    Raises:
        TFLabError: a text is empty.
    """
    return {given: _quote_override(given, texts, sweeps) for given in overrides}


def _quote_override(word: str, texts: Texts, sweeps: bool) -> str:
    """``NAME=VALUE`` so that Hydra takes the value as it stands, if the setting is a text."""
    match = re.fullmatch(r"(?s)(\+{0,2}([\w.]+)=)(.*)", word)
    if match is None or match[2] not in texts.names:
        return word
    start, name, value = match.groups()
    if not value.strip():
        raise TFLabError(f"{word}: is empty; give {name}=VALUE, or leave it out")
    sweeps = sweeps and name not in NEVER_SWEPT
    if sweeps and re.fullmatch(_CHOICE, value):
        return word
    parts, several = _split(value), name in texts.lists
    is_path = os.path.exists(os.path.expanduser(value))  # noqa: PTH110, PTH111
    if (sweeps or several) and len(parts) > 1 and not is_path:
        return start + ",".join(_quote(part, several) for part in parts)  # without -m, an error
    return start + _quote(value, several)


def _quote(value: str, several: bool) -> str:
    """The value of a setting for Hydra: null, a list of texts, or a text."""
    if value == "null":
        return value
    if several and value.startswith("[") and value.endswith("]"):
        return f"[{','.join(map(_quote_text, _split(value[1:-1])))}]"
    return _quote_text(value)


def _quote_text(value: str) -> str:
    """A text for Hydra's grammar; one that is quoted for it already stays as it is."""
    if re.fullmatch(rf"(?s){_QUOTED}", value):
        return value
    try:
        override = OverridesParser.create().parse_override(f"x={value}")
        plain = "${" not in value and not re.search(_ESCAPED, value)
        if plain and override.value() == value and not override.is_sweep_override():
            return value
    except HydraException:
        pass
    return QuotedString(literal(value), Quote.single).with_quotes()


def _split(value: str) -> list[str]:
    """The parts between commas, without the blanks around them."""
    return [part.strip() for part in re.findall(_PART, value) if part.strip()]
