"""What is around every command."""

import io
import sys

import pytest

from tf_lab.cli.command import print_anything


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
