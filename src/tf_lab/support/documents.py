"""JSON and YAML from disk: within bounds, so that no file takes more than its reading is worth.

Size is bounded before anything is parsed; depth, the number of items (a few hundred bytes of YAML
aliases may stand for any number) and the digits of numbers while it is, or right after. What comes
out is made of mappings, lists, texts, numbers, truth values and null, as in JSON, and of nothing
else: YAML's dates are texts, its tags are refused. `tf_lab.support.records` gives it types.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from tf_lab.errors import TFLabError
from tf_lab.support.text import read_text

MOST_YAML = 2**20  # bytes; its parser is slow
MOST_DEPTH = 40
MOST_ITEMS = 2_000_000
MOST_YAML_ITEMS = 200_000
MOST_DIGITS = 40


def read_json(path: Path, cure: str) -> Any:
    """What a JSON file holds.

    Raises:
        TFLabError: as `read_text`, or it is not JSON, or out of bounds.
    """
    return _parsed(path, read_text(path, cure), parse_json, cure)


def read_yaml(path: Path, cure: str) -> Any:
    """What a YAML file holds.

    Raises:
        TFLabError: as `read_text`, or it is not YAML, or out of bounds.
    """
    return _parsed(path, read_text(path, cure, MOST_YAML), parse_yaml, cure)


def _parsed(path: Path, text: str, parse: Callable[[str], Any], cure: str) -> Any:
    try:
        return parse(text)
    except ValueError as error:
        raise TFLabError(f"{path}: {error}; {cure}") from error


def parse_json(text: str | bytes) -> Any:
    """What a JSON text holds.

    Raises:
        ValueError: it is not JSON, or out of bounds; the message says which.
    """
    try:
        found = json.loads(text, parse_int=_whole)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"damaged: not JSON ({_first_line(error)})") from error
    return _bounded(found)


def parse_yaml(text: str) -> Any:
    """What a YAML text holds.

    Raises:
        ValueError: it is not YAML, or out of bounds; the message says which.
    """
    try:
        found = yaml.load(text, _Loader)
    except Exception as error:  # PyYAML raises nearly anything
        raise ValueError(f"damaged: not YAML ({_first_line(error)})") from error
    return _bounded(found, MOST_YAML_ITEMS)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [""])[0][:80] or type(error).__name__


def _whole(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


class _Loader(yaml.SafeLoader):
    """Of plain values: dates are texts, and nothing is merged, which grows without bound."""

    def construct_number(self, node: yaml.ScalarNode) -> Any:
        if len(node.value) > MOST_DIGITS:
            raise ValueError(f"a number of {len(node.value)} digits")
        whole = node.tag.endswith(":int")
        return self.construct_yaml_int(node) if whole else self.construct_yaml_float(node)


_Loader.yaml_implicit_resolvers = {
    first: [(tag, rule) for tag, rule in rules if not tag.endswith((":timestamp", ":merge"))]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _tag in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", _Loader.construct_number)


def _bounded(document: Any, most: int = MOST_ITEMS) -> Any:
    """The document itself.

    Raises:
        ValueError: it is too deep (or holds itself), too large, or holds what JSON does not know.
    """
    count, level = 0, [document]
    for _ in range(MOST_DEPTH):
        deeper: list[Any] = []
        for value in level:
            if isinstance(value, dict | list):
                items = [*value, *value.values()] if isinstance(value, dict) else value
                count += len(items)
                if count > most:
                    raise ValueError(f"damaged: holds more than {most} items")
                deeper += [v for v in items if not isinstance(v, float)]
            elif isinstance(value, str):
                if not (value.isascii() or _is_text(value)):
                    raise ValueError(f"damaged: {value[:40]!a} is no text")
            elif not (value is None or isinstance(value, int | float)):
                raise ValueError(f"damaged: holds a {type(value).__name__}")
        if not deeper:
            return document
        level = deeper
    raise ValueError(f"damaged: nested more than {MOST_DEPTH} deep")


def _is_text(value: str) -> bool:
    """Whether it can be written: JSON may name halves of characters."""
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True
