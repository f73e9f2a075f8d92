"""Interchangeable parts by name: how tf_lab finds a strategy, policy, data source or metric.

A part is registered by where it is, not by the object, so that ``--help`` need not import torch::

    FUSIONS.add(
        FusionPart("gru", "tf_lab.network.fusion.gru:GRUFusion", GRUSettings, label="GRU")
    )

Parts of other packages are registered by a module that an entry point of the group
``tf_lab.parts`` names; see docs/extending.md.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any, Generic, TypeVar

from tf_lab.errors import TFLabError
from tf_lab.support.settings import check_given

ENTRY_POINTS = "tf_lab.parts"


@dataclass(frozen=True)
class Part:
    """A part by name.

    Attributes:
        name: in configs, checkpoints and the names of runs.
        target: where it is, as ``package.module:attribute``.
        settings: frozen dataclass of its hyper-parameters; see `tf_lab.support.settings`. The
            first line of its docstring is what ``--help`` says of it.
        option: what is written on the command line (``select=rnd``); "": the name.
    """

    name: str
    target: str
    settings: type
    option: str = ""

    @property
    def choice(self) -> str:
        """As on the command line."""
        return self.option or self.name

    def load(self) -> Any:
        """The object itself, imported now.

        Raises:
            TFLabError: it is not there.
        """
        module, _, attribute = self.target.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            raise TFLabError(f"{self.name}: {self.target} cannot be imported ({error})") from error


P = TypeVar("P", bound=Part)


class Registry(Generic[P]):
    """The parts of one kind.

    Args:
        group: of the command line and of the config, as in ``fusion=gru``.
        key: the setting that holds a part's name, as in ``fusion.strategy``.
    """

    def __init__(self, group: str, key: str) -> None:
        self.group, self.key = group, key
        self._parts: dict[str, P] = {}

    def add(self, part: P) -> None:
        """Register a part.

        Raises:
            TFLabError: another part has its name, its name is none for a command line, or its
                settings are not made as `tf_lab.support.settings` says.
        """
        self._check(part)
        known = self._parts.setdefault(part.name, part)
        if known != part:
            raise TFLabError(
                f"{self.group}={part.name}: both {known.target} and {part.target} are called so; "
                "rename one"
            )

    def _check(self, part: P) -> None:
        kind, who = part.settings, f"{self.group}={part.name}"
        if not re.fullmatch(r"\w+", part.name):
            raise TFLabError(f"{who}: name it by letters, digits and _ alone")
        if not is_dataclass(kind):
            raise TFLabError(f"{who}: {kind.__name__} is no dataclass of settings")
        plain = [field.name for field in fields(kind) if "shapes" not in field.metadata]
        if plain:
            raise TFLabError(
                f"{who}: {kind.__name__}.{plain[0]} is to be made by setting(), which says what "
                "it shapes: runs are told apart by that"
            )
        named = [field.default for field in fields(kind) if field.name == self.key]
        if named not in ([part.name], [MISSING]):
            is_now = f"is {named[0]!r} by default" if named else "is missing"
            raise TFLabError(f"{who}: {kind.__name__}.{self.key} {is_now}; make it {part.name!r}")

    def __iter__(self) -> Iterator[P]:
        """All parts, those of other packages last."""
        load_entry_points()
        return iter(list(self._parts.values()))

    def __getitem__(self, name: str) -> P:
        """The part of a name.

        Raises:
            TFLabError: there is none.
        """
        if name not in self._parts:
            load_entry_points()
        if name not in self._parts:
            names = ", ".join(self._parts)
            raise TFLabError(f"{self.group}.{self.key}={name}: choose one of {names}")
        return self._parts[name]

    def __contains__(self, name: object) -> bool:
        """Whether there is a part of a name."""
        return any(part.name == name for part in self)

    def named(self, settings: Any) -> P:
        """The part that settings are of."""
        return self[getattr(settings, self.key)]

    def settings(self, given: Any) -> Any:
        """Settings of a part: as they are, of a name (all else by default), or of a mapping.

        Raises:
            TFLabError: there is no such part, or it has no such settings or values of them.
        """
        if isinstance(given, str):
            given = {self.key: given}
        if not isinstance(given, Mapping):
            return given
        try:
            kind = self[given.get(self.key, "")].settings
            check_given(kind, given, f"{self.group}.")
            return kind(**given)
        except TypeError as error:
            raise TFLabError(f"{self.group}={given[self.key]}: {error}") from error

    def make(self, given: Any, *arguments: Any) -> Any:
        """A part's object: its target called with arguments, and with its settings by name.

        Args:
            given: as of `settings`.
            arguments: what all parts of this kind are made with.
        """
        settings = self.settings(given)
        names = [field.name for field in fields(settings) if field.name != self.key]
        return self.named(settings).load()(
            *arguments, **{name: getattr(settings, name) for name in names}
        )


@functools.cache
def load_entry_points() -> None:
    """Let other packages register their parts.

    Raises:
        TFLabError: one of them cannot be imported.
    """
    for point in importlib.metadata.entry_points(group=ENTRY_POINTS):
        try:
            point.load()
        except Exception as error:  # whatever goes wrong in the code of others
            raise TFLabError(
                f"{point.value}: cannot be imported ({type(error).__name__}: {error}); it is an "
                f"entry point {ENTRY_POINTS} of an installed package"
            ) from error
