"""Words with numbers in them."""

from __future__ import annotations

import re
from collections.abc import Sequence


def counted(number: int, noun: str) -> str:
    """As in "1 frame", "0 frames", "2 frames"."""
    return f"{number} {noun}{'s' * (number != 1)}"


def shortened(names: Sequence[str], most: int = 8) -> str:
    """The first of some names, and how many more there are."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def natural(text: str) -> list[tuple[str, int, str]]:
    """A key to sort by, with numbers as numbers: "4 images" before "16 images"."""
    # alternating words and digits; of two numbers, that with more digits is larger
    parts = ((word.lower(), digits) for word, digits in re.findall(r"(\D*)(\d*)", text))
    return [(word, len(d.lstrip("0")) if d else -1, d.lstrip("0")) for word, d in parts]
