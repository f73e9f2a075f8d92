"""Objects that a config names by their class: loggers, callbacks, arguments of the trainer.

A node is ``{_target_: package.module.Class, argument: value, ...}``, as `hydra.utils.instantiate`
takes it. What may be named is restricted, as a config may come from somebody else: a class, of a
package that training is made of or that has registered parts of its own.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Iterator
from pkgutil import resolve_name
from typing import Any, TypeVar, cast

from hydra.errors import InstantiationException
from hydra.utils import instantiate
from lightning.pytorch.callbacks import Callback

from tf_lab.config.schema import TrainConfig
from tf_lab.errors import TFLabError
from tf_lab.support.registry import ENTRY_POINTS

PACKAGES = ("lightning", "pytorch_lightning", "torch", "tf_lab")
TARGET = "_target_"

T = TypeVar("T")


def make(kind: Callable[..., T], name: str, node: dict[str, Any], /, **arguments: Any) -> T:
    """The object that a node describes.

    Args:
        kind: of which it has to be.
        name: of the setting, for messages.
        node: its class and arguments.
        arguments: more of these, as they are.

    Raises:
        TFLabError: it is no such object, may not be made, or cannot be.
    """
    made = _class(name, node.get(TARGET))
    if not issubclass(made, cast(type, kind)):
        raise TFLabError(f"{name}.{TARGET}={node[TARGET]}: is no {cast(type, kind).__name__}")
    known = {key: value for key, value in node.items() if key not in arguments}
    partial = instantiated(name, {**known, "_partial_": True})
    try:
        return partial(**arguments)
    except (TypeError, ValueError) as error:
        raise TFLabError(f"{name}: {node[TARGET]}: {error}") from error


def make_callbacks(config: TrainConfig) -> list[Callback]:
    """What ``callbacks`` adds to a training, by any name.

    Raises:
        TFLabError: one is no callback, may not be made, or cannot be.
    """
    return [make(Callback, f"callbacks.{name}", node) for name, node in config.callbacks.items()]


def instantiated(name: str, node: dict[str, Any]) -> Any:
    """A node (a dict with ``_target_``), or a dict of which some values are nodes, as objects.

    Raises:
        TFLabError: one may not be made, or cannot be.
    """
    for where, target in _targets(node, name):
        _class(where, target)
    try:
        return instantiate(node, _convert_="all")
    except InstantiationException as error:
        raise TFLabError(f"{name}: {' '.join(str(error).split())}") from error


def _targets(node: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Every class named in a node, and where."""
    items = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in items:
        if key == TARGET:
            yield name, value
        if isinstance(value, dict | list):
            yield from _targets(value, f"{name}.{key}")


def _class(name: str, target: Any) -> type:
    """The class of a name that may be made.

    Raises:
        TFLabError: it may not, or is not there.
    """
    where = f"{name}.{TARGET}={target}"
    points = importlib.metadata.entry_points(group=ENTRY_POINTS)
    packages = [*PACKAGES, *sorted({point.module.partition(".")[0] for point in points})]
    if str(target).partition(".")[0] not in packages:
        raise TFLabError(f"{where}: only classes of {', '.join(packages)} may be named in a config")
    try:
        found = resolve_name(str(target))
    except Exception as error:  # whatever goes wrong at importing it
        raise TFLabError(f"{where}: cannot be imported; is its package installed?") from error
    if not isinstance(found, type):
        raise TFLabError(f"{where}: is no class")
    return found
