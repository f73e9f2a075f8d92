"""Sweet Home 3D's catalogues: zips of models or of images, and a list that says what each is."""

from __future__ import annotations

import hashlib
import re
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tf_lab.errors import TFLabError


@dataclass(frozen=True)
class Archive:
    """A catalogue's file.

    Attributes:
        path: of it.
        about: what its list says of the whole.
        entries: what it says of each thing, in its order.
        infos: what is in the file, by name.
    """

    path: Path
    about: dict[str, str]
    entries: Sequence[dict[str, str]]
    infos: dict[str, zipfile.ZipInfo]

    @property
    def licence(self) -> str:
        """As it is stated."""
        return self.about.get("license", "no licence stated")


def read_archive(path: Path, lists: Sequence[str], what: str) -> Archive:
    """A catalogue's list and contents.

    Args:
        path: of the file.
        lists: where its list may be in it.
        what: it should be, for the message.

    Raises:
        TFLabError: it is none.
    """
    try:
        with zipfile.ZipFile(path) as file:
            infos = {info.filename: info for info in file.infolist()}
            name = next((name for name in lists if name in infos), lists[0])
            about, entries = _parse(file.read(name).decode("latin-1"))
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise TFLabError(f"{path}: not a {what} ({error})") from error
    return Archive(path, about, entries, infos)


def digest_of(archives: Iterable[tuple[Archive, Iterable[str]]]) -> str:
    """A hash of what the named files of some catalogues hold, wherever these lie."""
    digest = hashlib.sha256()
    for archive, names in archives:
        for name in sorted(names):
            digest.update(f"{archive.path.name} {name} {archive.infos[name].CRC}\n".encode())
    return digest.hexdigest()[:16]


def _parse(text: str) -> tuple[dict[str, str], Sequence[dict[str, str]]]:
    """The lines of a list: what is said of the catalogue, and of each thing in it."""
    about: dict[str, str] = {}
    entries: dict[str, dict[str, str]] = {}
    for line in text.splitlines():
        found = re.fullmatch(r"\s*(\w+)(?:#(\d+))?\s*=\s*(.*?)\s*", line)
        if found is not None:
            key, number, value = found.groups()
            value = re.sub(r"\\u([0-9a-fA-F]{4})", lambda m: chr(int(m[1], 16)), value)
            (about if number is None else entries.setdefault(number, {}))[key] = value
    return about, list(entries.values())
