"""What is around every command."""

import io
import os
import sys
from typing import Any

import pytest

from tf_lab.cli.command import command, print_anything


@pytest.mark.parametrize("encoding", ["ascii", "utf-8"])
def test_what_cannot_be_printed_ends_nothing(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in an ASCII locale, or of file names that are not text."""
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding=encoding))
    print_anything()
    print("Küche ↓ \udcc3", flush=True)
    assert written.getvalue().decode("utf-8") == (
        "Küche ↓ ?\n" if encoding != "ascii" else "K?che ? ?\n"
    )


@pytest.mark.parametrize("name", ["TF_LAB_CACHE", "XDG_CACHE_HOME"])
@pytest.mark.parametrize(("given", "expected"), [("", None), ("there", "there")])
def test_an_empty_cache_is_none(
    name: str, given: str, expected: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else data sets would be rendered into the current folder."""
    monkeypatch.setattr(os, "environ", {name: given})
    monkeypatch.setattr("tf_lab.cli.run.run_command", lambda *_: None)
    command("train", "About.", "nowhere:run")()
    assert os.environ.get(name) == expected


@pytest.mark.parametrize(
    ("given", "expected"),
    [({}, "1000"), ({"GOMP_SPINCOUNT": "5"}, "5"), ({"OMP_WAIT_POLICY": "ACTIVE"}, None)],
)
def test_threads_do_not_wait_in_circles(
    given: dict[str, str], expected: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless somebody wants that."""
    monkeypatch.setattr(os, "environ", {**given})
    ran: list[Any] = []
    monkeypatch.setattr("tf_lab.cli.run.run_command", lambda *values: ran.extend(values))
    command("train", "About.", "nowhere:run")()
    assert ran[0] == "train"
    assert os.environ.get("GOMP_SPINCOUNT") == expected
