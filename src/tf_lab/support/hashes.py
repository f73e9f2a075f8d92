"""Short hashes of values, by which what is made of the same is found again."""

from __future__ import annotations

import hashlib
import json
from typing import Any


def hash_of(values: Any, length: int = 10, sort_keys: bool = False) -> str:
    """The first hexadecimal digits of a hash of what JSON can hold.

    Args:
        values: numbers, texts, lists, mappings.
        length: digits.
        sort_keys: whether mappings of another order are the same.
    """
    text = json.dumps(values, sort_keys=sort_keys)
    return hashlib.sha256(text.encode()).hexdigest()[:length]
