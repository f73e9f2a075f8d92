"""Settings as frozen dataclasses whose fields say what they mean and what they shape.

A setting is declared once, where it is used::

    @dataclass(frozen=True)
    class GRUSettings:
        strategy: str = setting("gru", "of fusing the views of a voxel", shapes="weights")
        layers: int = setting(1, "recurrent layers", shapes="weights")

Its type is checked, its text is what ``--help`` prints, and what it shapes decides which runs are
the same (see `tf_lab.experiments.identity`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import MISSING
from typing import Any, Literal

from tf_lab.errors import TFLabError

Shapes = Literal["weights", "scores", "nothing"]
Kind = Literal["value", "path", "source"]


def setting(
    default: Any = MISSING,
    about: str = "",
    *,
    shapes: Shapes = "nothing",
    kind: Kind = "value",
    several: bool = False,
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
    """
    metadata = {"about": about, "shapes": shapes, "kind": kind, "several": several}
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
        value = getattr(settings, field.name)
        if isinstance(value, dict) and all(map(dataclasses.is_dataclass, value.values())):
            parts = {name: shaping(part, what) for name, part in value.items()}
            found |= {field.name: parts} if any(parts.values()) else {}
        elif dataclasses.is_dataclass(value):
            found |= {field.name: inner} if (inner := shaping(value, what)) else {}
        elif field.metadata.get("shapes", "nothing") == what:
            found[field.name] = value
    return found


def described(settings: Any, prefix: str = "") -> Iterator[tuple[str, dataclasses.Field[Any]]]:
    """The dotted name and the field of every setting of a dataclass, nested ones included."""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name, None)
        if dataclasses.is_dataclass(value):
            yield from described(value, f"{prefix}{field.name}.")
        else:
            yield f"{prefix}{field.name}", field


def at_least(least: float, group: str, settings: Any, *names: str) -> None:
    """That settings of a group are no less than a number; None is no number.

    Raises:
        TFLabError: one is less.
    """
    for name in names:
        value = getattr(settings, name)
        if value is not None and value < least:
            raise TFLabError(f"{group}{name}={value}: must be at least {least:g}")


def lists_to_tuples(settings: Any) -> None:
    """Make a frozen dataclass' lists tuples, in ``__post_init__``: configs know only lists."""
    for field in dataclasses.fields(settings):
        if isinstance(value := getattr(settings, field.name), list):
            object.__setattr__(settings, field.name, tuple(value))
