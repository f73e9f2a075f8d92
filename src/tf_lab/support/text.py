"""Text files as people's tools write them, for all readers: one place for encodings and comments.

Windows editors and PowerShell put a byte order mark in front (UTF-8 or UTF-16), numpy heads what it
saves with ``#`` lines, spreadsheets separate by commas.
"""

from __future__ import annotations

import codecs
import re
import stat
from pathlib import Path

from tf_lab.errors import TFLabError

MAX_TEXT = 64 * 2**20  # bytes; pose and camera files are far smaller


def read_text(path: Path, cure: str, most: int = MAX_TEXT) -> str:
    """A text file in UTF-8, or in UTF-16 with a byte order mark.

    Args:
        path: the file.
        cure: what to do if it is none.
        most: bytes that it may have.

    Raises:
        TFLabError: missing, not text or absurdly large; the message ends with the cure.
    """
    try:
        found = path.stat()
        if found.st_size > most:
            raise TFLabError(f"{path}: too large to be this file; {cure}")
        if stat.S_ISFIFO(found.st_mode):  # it would wait for whoever writes into it
            raise TFLabError(f"{path}: a pipe, not a file; {cure}")
        content = path.read_bytes()
        wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return content.decode("utf-16" if wide else "utf-8-sig")
    except FileNotFoundError as error:
        raise TFLabError(f"{path}: missing; {cure}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise TFLabError(f"{path}: cannot be read as text ({error}); {cure}") from error


def read_lines(path: Path, cure: str) -> list[tuple[int, str]]:
    """The lines of a text file that say something, stripped, each with its number from 1.

    Empty lines and those that start with ``#`` say nothing.

    Raises:
        TFLabError: as `read_text`.
    """
    lines = enumerate((line.strip() for line in read_text(path, cure).splitlines()), start=1)
    return [(number, line) for number, line in lines if line and not line.startswith("#")]


def read_numbers(path: Path, cure: str) -> list[float]:
    """All numbers of a text file (see `parse_numbers`), whatever its lines.

    Raises:
        TFLabError: as `read_text`, or something in it is no number.
    """
    try:
        return parse_numbers(read_text(path, cure))
    except ValueError as error:
        raise TFLabError(f"{path}: not numbers ({error}); {cure}") from error


def parse_numbers(text: str) -> list[float]:
    """Numbers between blanks, commas or semicolons, maybe in brackets; NaN and infinity are some.

    What follows a ``#`` in its line is a comment.

    Raises:
        ValueError: something else is in it.
    """
    return [float(word) for word in re.split(r"[\s,;\[\]]+", re.sub("#.*", "", text)) if word]
