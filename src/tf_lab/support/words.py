"""Numbers with their nouns."""

from __future__ import annotations


def counted(number: int, noun: str) -> str:
    """As in "1 frame", "0 frames", "2 frames"."""
    return f"{number} {noun}{'s' * (number != 1)}"
