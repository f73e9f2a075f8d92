"""Documents from disk are read within bounds, and become records or one clear line."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict

import pytest

from helpers.fuzz.mutations import BOMB, CODE, DEEP, MERGE
from tf_lab.errors import TFLabError
from tf_lab.support.documents import parse_json, parse_yaml, read_json, read_yaml
from tf_lab.support.files import file_name
from tf_lab.support.records import read_record, record


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (DEEP, "not JSON"),
        ("[" * 100 + "]" * 100, "nested more than"),
        ("1" * 400, "a number of 400 digits"),
        (r'"\ud800"', "no text"),
        ("{", "not JSON"),
    ],
)
def test_json_out_of_bounds(text: str, expected: str) -> None:
    with pytest.raises(ValueError, match=f"damaged: .*{expected}"):
        parse_json(text)


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (BOMB, "more than"),
        (MERGE, "more than|nested"),
        ("&a [*a]", "nested more than"),
        ("a: &a {b: *a}", "nested more than"),
        ("a: " + "9" * 400, "a number of 400 digits"),
        ("a: " + "1:" * 400 + "1", "not YAML|a number"),
        ("a: !!binary aGk=", "holds a bytes"),
        ("a: !!timestamp 2020-01-01", "holds a date"),
        (CODE, "not YAML"),
        ("? [a, b]\n: c", "not YAML"),
        ("a: [", "not YAML"),
    ],
)
def test_yaml_out_of_bounds(text: str, expected: str) -> None:
    with pytest.raises(ValueError, match=f"damaged: .*({expected})"):
        parse_yaml(text)
    assert not Path("../outside").exists()


def test_ordinary_documents() -> None:
    document = {"a": [1, 2.5, None, True, "ü"], "b": {"c": -(2**63)}}
    assert parse_json(json.dumps(document)) == document
    assert parse_yaml(json.dumps(document)) == document
    assert parse_yaml("a: &x {b: 2020-01-01}\nc: *x") == {
        "a": {"b": "2020-01-01"},  # dates are texts
        "c": {"b": "2020-01-01"},
    }


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("- a\n" * 300_000)
    with pytest.raises(TFLabError, match=r"a\.yaml: too large to be this file; make it anew"):
        read_yaml(path, "make it anew")
    path.write_text("{")
    with pytest.raises(TFLabError, match=r"a\.yaml: damaged: not JSON .*; make it anew"):
        read_json(path, "make it anew")


class Origin(TypedDict, total=False):
    commit: str


@dataclass(frozen=True)
class Example:
    name: str
    size: tuple[int, int]
    scores: dict[str, dict[str, float]]
    origin: Origin
    skipped: list[str] | None = None


GOOD: dict[str, Any] = {"name": "a", "size": [4, 3], "scores": {"x": {"f": 1}}, "origin": {"z": 1}}


def test_a_record() -> None:
    assert record(Example, GOOD) == Example("a", (4, 3), {"x": {"f": 1.0}}, {"z": 1})  # type: ignore[typeddict-unknown-key]
    assert record(Example, {**GOOD, "skipped": ["b"], "more": 1}).skipped == ["b"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"name": 3}, "name is 3, not text"),
        ({"size": "4x3"}, "size is '4x3', not a list of 2"),
        ({"size": [4]}, "size is list, not a list of 2"),
        ({"size": [4, True]}, r"size\[1\] is True, not a whole number"),
        ({"scores": {"x": {"f": float("nan")}}}, "scores.x.f is nan, not a finite number"),
        ({"scores": {"x": {"f": 10**400}}}, r"scores.x.f is 1000.*\.\.\., not a finite number"),
        ({"scores": []}, "scores is list, not a mapping"),
        ({"origin": {"commit": None}}, "origin.commit is None, not text"),
        ({"skipped": 1}, "skipped is 1, not a list"),
    ],
)
def test_no_record(change: dict[str, Any], expected: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=expected):
        record(Example, {**GOOD, **change})
    with pytest.raises(ValueError, match="name is missing"):
        record(Example, {k: v for k, v in GOOD.items() if k != "name"})
    path = tmp_path / "x.json"
    path.write_text("[]")
    with pytest.raises(TFLabError, match=r"x\.json: the document is list, not a mapping; cure"):
        read_record(Example, path, "cure")


@pytest.mark.parametrize("name", ["scene0000_00", "ä b", "frame.000001", "12:30", " a", "x" * 180])
def test_ordinary_names_stay(name: str) -> None:
    assert file_name(name) == name


def test_no_name_leaves_its_folder(tmp_path: Path) -> None:
    names = ["../../x", "..", ".", "", "/etc/x", "a/b", "a_b", "a\\b", "a\0b", "y" * 300, "\ud800"]
    found = [file_name(name) for name in names]
    assert len(set(found)) == len(names)
    assert [file_name(name) for name in found] == found
    for name in found:
        (tmp_path / f"{name}.jpg").touch()
    assert len([*tmp_path.iterdir()]) == len(names)
