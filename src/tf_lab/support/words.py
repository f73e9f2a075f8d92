"""Words with numbers in them."""

from __future__ import annotations

import re


def counted(number: int, noun: str) -> str:
    """As in "1 frame", "0 frames", "2 frames"."""
    return f"{number} {noun}{'s' * (number != 1)}"


def natural(text: str) -> list[tuple[str, int, str]]:
    """A key to sort by, with numbers as numbers: "4 images" before "16 images"."""
    # alternating words and digits; of two numbers, that with more digits is larger
    parts = ((word.lower(), digits) for word, digits in re.findall(r"(\D*)(\d*)", text))
    return [(word, len(d.lstrip("0")) if d else -1, d.lstrip("0")) for word, d in parts]
