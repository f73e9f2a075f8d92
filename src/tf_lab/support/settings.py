"""Settings as frozen dataclasses whose fields say what they mean and what they shape.

A setting is declared once, where it is used::

    @dataclass(frozen=True)
    class GRUSettings:
        strategy: str = setting("gru", "of fusing the views of a voxel", shapes="weights")
        layers: int = setting(1, "recurrent layers", shapes="weights")

Its type and its range are checked, its text is what ``--help`` prints, and what it shapes decides
which runs are the same (see `tf_lab.experiments.identity`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import MISSING
from typing import Any, Literal, get_args, get_type_hints

from tf_lab.errors import TFLabError
from tf_lab.support.records import record

Shapes = Literal["weights", "scores", "nothing"]
Kind = Literal["value", "path", "source"]
MOST_SEED = 2**32 - 1  # of numpy's and of Lightning's
SMALLEST, LARGEST = 1e-18, 1e18  # magnitudes whose squares are numbers in float32, too


@dataclasses.dataclass(frozen=True)
class Range:
    """Which numbers a setting may be: from ``least`` or above ``above`` up to ``most``."""

    least: float | None = None
    above: float | None = None
    most: float | None = None

    def __contains__(self, number: float) -> bool:
        return (
            (self.least is None or number >= self.least)
            and (self.above is None or number > self.above)
            and (self.most is None or number <= self.most)
        )

    def __str__(self) -> str:
        parts = [
            *([] if self.least is None else [f"at least {self.least:.10g}"]),
            *([] if self.above is None else [f"more than {self.above:.10g}"]),
            *([] if self.most is None else [f"at most {self.most:.10g}"]),
        ]
        return " and ".join(parts)


def setting(
    default: Any = MISSING,
    about: str = "",
    *,
    shapes: Shapes = "nothing",
    kind: Kind = "value",
    several: bool = False,
    absent: Any = MISSING,
    least: float | None = None,
    above: float | None = None,
    most: float | None = None,
) -> Any:
    """A documented field of a settings dataclass.

    Args:
        default: its value unless somebody gives one; a list, dict or dataclass is copied. Without
            a default the value has to be given (in a file of ``conf/`` or on the command line).
        about: what it means, with its unit, as ``--help`` prints it.
        shapes: "weights": other values train another network; "scores": they only evaluate it
            otherwise; "nothing": results are the same.
        kind: "path": a place on this machine, in which ``~`` is expanded; "source": a place or a
            name, likewise. Whatever they look like, they are text.
        several: a list of texts may be given as well as one.
        absent: of a setting that came later, the value that means what was before; with it runs are
            the same as those that did not have the setting.
        least: the smallest that its numbers, or those in it, may be; see `check_ranges`.
        above: what they must be more than.
        most: the largest that they may be.

    Raises:
        TFLabError: it shapes nothing that there is.
    """
    if shapes not in get_args(Shapes):
        raise TFLabError(f"shapes={shapes!r}: a setting shapes {', '.join(get_args(Shapes))}")
    metadata = {"about": about, "shapes": shapes, "kind": kind, "several": several}
    metadata["absent"] = absent
    metadata["range"] = Range(least, above, most)
    if default is MISSING:
        return dataclasses.field(metadata=metadata)
    if isinstance(default, list | dict) or dataclasses.is_dataclass(default):
        copied = default
        return dataclasses.field(
            default_factory=lambda: copied.copy() if isinstance(copied, list | dict) else copied,
            metadata=metadata,
        )
    return dataclasses.field(default=default, metadata=metadata)


def shaping(settings: Any, what: Shapes) -> dict[str, Any]:
    """The settings of a dataclass, nested ones included, that shape ``what``; nothing empty."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(settings):
        value, absent = getattr(settings, field.name), field.metadata.get("absent", MISSING)
        if isinstance(value, dict) and all(map(dataclasses.is_dataclass, value.values())):
            parts = {name: shaping(part, what) for name, part in value.items()}
            found |= {field.name: parts} if any(parts.values()) else {}
        elif dataclasses.is_dataclass(value):
            found |= {field.name: inner} if (inner := shaping(value, what)) else {}
        elif field.metadata.get("shapes", "nothing") == what and value != absent:
            found[field.name] = value
    return found


def absent_values(kind: type) -> dict[str, Any]:
    """Of the settings that came later, by name: the values that mean what was before."""
    later = {f.name: f.metadata.get("absent", MISSING) for f in dataclasses.fields(kind)}
    return {name: value for name, value in later.items() if value is not MISSING}


def check_ranges(settings: Any, prefix: str = "") -> None:
    """That the numbers of a settings dataclass, nested ones included, are in their ranges.

    Raises:
        TFLabError: one is not, or none that a computer computes with: NaN, infinite, beyond
            `SMALLEST` or `LARGEST`; it is named with ``prefix`` in front.
    """
    for field in dataclasses.fields(settings):
        _check_field(field, getattr(settings, field.name), f"{prefix}{field.name}")


def check_given(kind: type, given: Mapping[str, Any], prefix: str = "") -> None:
    """That values from a file, meant for a settings dataclass, have its types and ranges.

    Raises:
        TFLabError: one has not; it is named with ``prefix`` in front.
    """
    hints = get_type_hints(kind)
    for field in dataclasses.fields(kind):
        if field.name in given:
            name = f"{prefix}{field.name}"
            try:
                _check_field(field, record(hints[field.name], given[field.name], name), name)
            except ValueError as error:
                raise TFLabError(str(error)) from error


def _check_field(field: dataclasses.Field[Any], value: Any, name: str) -> None:
    allowed = field.metadata.get("range", Range())
    if dataclasses.is_dataclass(value):
        check_ranges(value, f"{name}.")
    elif isinstance(value, dict) and all(map(dataclasses.is_dataclass, value.values())):
        for key, part in value.items():
            check_ranges(part, f"{name}.{key}.")
    elif isinstance(value, list | tuple):
        _check(allowed, name, value, value)
    elif not isinstance(value, dict):
        _check(allowed, name, value, [value])
    elif allowed != Range():  # else a dictionary of anything
        for key, item in value.items():
            _check(allowed, f"{name}.{key}", item, [item])


def _check(allowed: Range, name: str, value: Any, items: Iterable[Any]) -> None:
    for item in items:
        if isinstance(item, bool) or not isinstance(item, int | float):
            continue
        if item not in allowed:
            raise TFLabError(f"{name}={value}: must be {allowed}")
        if item != 0 and not SMALLEST <= abs(item) <= LARGEST:  # true of NaN
            raise TFLabError(f"{name}={value}: must be 0 or from {SMALLEST} to {LARGEST} in size")


def plain_values(settings: Any) -> None:
    """Make a frozen dataclass' lists, of which alone configs know, tuples, and numpy's values
    Python's; for ``__post_init__``.
    """
    for field in dataclasses.fields(settings):
        given = getattr(settings, field.name)
        value = given.tolist() if hasattr(given, "tolist") else given
        value = tuple(value) if isinstance(value, list) else value
        if value is not given:
            object.__setattr__(settings, field.name, value)
