"""Documents from disk as typed records: what is wrong is one line that names the field."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from tf_lab.errors import TFLabError
from tf_lab.support.documents import read_json

T = TypeVar("T")


def read_record(kind: type[T], path: Path, cure: str) -> T:
    """A JSON file as a record; see `record`.

    Raises:
        TFLabError: it cannot be read, or is something else.
    """
    try:
        return record(kind, read_json(path, cure))
    except ValueError as error:
        raise TFLabError(f"{path}: {error}; {cure}") from error


def record(kind: type[T], document: Any, name: str = "") -> T:
    """A document as a dataclass, a TypedDict or what these are made of.

    Known are dataclasses (fields that are not theirs are passed over), TypedDicts (others are
    kept), lists, tuples, mappings by text, unions, texts, truth values, whole numbers and
    finite ones, and Any.

    Args:
        kind: the type.
        document: of `tf_lab.support.documents`.
        name: of the field, for the message.

    Raises:
        ValueError: a field is missing, or something else; the message says which and what.
    """
    origin = get_origin(kind) or kind
    if origin is Any:
        return document
    if origin in (Union, types.UnionType):
        return _union(kind, document, name)
    if dataclasses.is_dataclass(kind):
        return _dataclass(kind, document, name)
    reader = _READERS.get(origin, _typed_dict)
    return reader(kind, document, name)


def _dataclass(kind: type[T], document: Any, name: str) -> T:
    given = _mapping(document, name)
    found, hints = {}, get_type_hints(kind)
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        inner = f"{name}.{field.name}" if name else field.name
        if field.name in given:
            found[field.name] = record(hints[field.name], given[field.name], inner)
        elif field.default is field.default_factory is dataclasses.MISSING:
            raise ValueError(f"{inner} is missing")
    return kind(**found)


def _union(kind: Any, document: Any, name: str) -> Any:
    *others, last = (each for each in get_args(kind) if each is not types.NoneType)
    if document is None and types.NoneType in get_args(kind):
        return None
    for each in others:
        with contextlib.suppress(ValueError):
            return record(each, document, name)
    return record(last, document, name)


def _typed_dict(kind: Any, document: Any, name: str) -> Any:
    given = _mapping(document, name)
    hints = get_type_hints(kind)
    known = {
        key: record(hints[key], value, f"{name}.{key}" if name else key)
        for key, value in given.items()
        if key in hints
    }
    return {**given, **known}


def _mapping(document: Any, name: str) -> Mapping[str, Any]:
    if not isinstance(document, dict) or not all(isinstance(key, str) for key in document):
        raise _wrong(name, document, "a mapping")
    return document


def _dict(kind: Any, document: Any, name: str) -> Any:
    value = get_args(kind)[1]
    return {k: record(value, v, f"{name}.{k}") for k, v in _mapping(document, name).items()}


def _list(kind: Any, document: Any, name: str) -> Any:
    if not isinstance(document, list | tuple):
        raise _wrong(name, document, "a list")
    (item,) = get_args(kind)
    return [record(item, value, f"{name}[{i}]") for i, value in enumerate(document)]


def _tuple(kind: Any, document: Any, name: str) -> Any:
    items = get_args(kind)
    if items[-1] is Ellipsis:
        return tuple(_list(list[items[0]], document, name))  # type: ignore[valid-type]
    if not isinstance(document, list | tuple) or len(document) != len(items):
        raise _wrong(name, document, f"a list of {len(items)}")
    pairs = zip(items, document, strict=True)
    return tuple(record(item, value, f"{name}[{i}]") for i, (item, value) in enumerate(pairs))


def _text(_kind: Any, document: Any, name: str) -> Any:
    if not isinstance(document, str):
        raise _wrong(name, document, "text")
    return document


def _truth(_kind: Any, document: Any, name: str) -> Any:
    if not isinstance(document, bool):
        raise _wrong(name, document, "true or false")
    return document


def _whole(_kind: Any, document: Any, name: str) -> Any:
    if not isinstance(document, int) or isinstance(document, bool):
        raise _wrong(name, document, "a whole number")
    return document


def _number(_kind: Any, document: Any, name: str) -> Any:
    number = isinstance(document, int | float) and not isinstance(document, bool)
    if not number or not abs(document) <= sys.float_info.max:
        raise _wrong(name, document, "a finite number")
    return float(document)


def _wrong(name: str, found: Any, wanted: str) -> ValueError:
    return ValueError(f"{name or 'the document'} is {_short(found)}, not {wanted}")


def _short(found: Any) -> str:
    text = repr(found) if isinstance(found, str | int | float | None) else type(found).__name__
    return text if len(text) <= 40 else text[:40] + "..."


_READERS: dict[Any, Callable[[Any, Any, str], Any]] = {
    dict: _dict,
    Mapping: _dict,
    list: _list,
    tuple: _tuple,
    str: _text,
    bool: _truth,
    int: _whole,
    float: _number,
}
