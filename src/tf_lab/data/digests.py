"""What a capture's scene is made of: the files, and whether they still are what they were.

Files are told apart by size and time first, and by content where these differ, so that a look at
an unchanged capture reads nothing, and a copy of it elsewhere is the same.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from tf_lab.data.gravity import DIRECTION_FILE
from tf_lab.data.readers.replica import PARAMETERS
from tf_lab.errors import TFLabError
from tf_lab.support.documents import read_json
from tf_lab.support.files import write_json
from tf_lab.support.hashes import hash_of
from tf_lab.support.records import read_record

RECORD = "sources.json"
COMPANIONS = ("poses.txt", "K.txt", DIRECTION_FILE)  # of a video, beside it
ABOVE = (f"../{PARAMETERS}",)  # of Replica, for all its captures
NEVER_READ = (".md", ".zip", ".ply", ".obj", ".glb", ".db")  # notes, archives, results
OFFICIAL = ("_vh_clean_2.ply", "_vh_clean_2.labels.ply")  # ScanNet's, which are

Stamp = tuple[int, int]  # size in bytes, time of the last change in ns


@dataclass(frozen=True)
class Sources:
    """The files that a scene was made of.

    Attributes:
        stamps: size and time by the file's path relative to the capture's folder.
        contents: a hash of each file's content.
    """

    stamps: Mapping[str, Stamp]
    contents: Mapping[str, str]

    @property
    def digest(self) -> str:
        """A short hash of names and contents, the same wherever the capture lies."""
        return hash_of(sorted(self.contents.items()))

    def unchanged(self, source: Path) -> bool:
        """Whether the capture's files still have the same sizes and times."""
        try:
            return stamps_of(source, self.stamps) == self.stamps
        except OSError:
            return False

    def difference(self, older: Sources) -> str:
        """What is not as it was, in a few words."""
        new, old = self.contents, older.contents
        lines = [
            *(f"{name} changed" for name in sorted(new.keys() & old) if new[name] != old[name]),
            *(f"{name} added" for name in sorted(new.keys() - old)),
            *(f"{name} removed" for name in sorted(old.keys() - new)),
        ]
        return lines[0] + (f" and {len(lines) - 1} more" if lines[1:] else "") if lines else ""

    def write(self, folder: Path) -> None:
        """Note them in a folder, for `read_sources`."""
        write_json(folder / RECORD, {"digest": self.digest, **asdict(self)})


def read_sources(folder: Path) -> Sources | None:
    """What was noted in a folder; None: nothing that can be read."""
    try:
        return read_record(Sources, folder / RECORD, "prepare the scene again")
    except TFLabError:
        return None


def read_digest(folder: Path) -> str | None:
    """The digest alone of what was noted in a folder, much quicker; None: none that can be read."""
    try:
        found = read_json(folder / RECORD, "prepare the scene again")
    except TFLabError:
        return None
    digest = found.get("digest") if isinstance(found, dict) else None
    return digest if isinstance(digest, str) and re.fullmatch("[0-9a-f]{10}", digest) else None


def find_sources(source: Path, also: Iterable[str] = (), known: Sources | None = None) -> Sources:
    """The files of a capture as they are now.

    Args:
        source: its folder, or its file.
        also: files that it refers to, by their paths from the folder.
        known: as they were; a file of the same size and time is not read again.

    Raises:
        TFLabError: one cannot be read.
    """
    folder = _folder(source)
    try:
        stamps = stamps_of(source, also)
        old = known or Sources({}, {})
        contents = {
            name: old.contents[name] if old.stamps.get(name) == stamp else _hash(folder / name)
            for name, stamp in stamps.items()
        }
    except OSError as error:
        raise TFLabError(f"{error.filename}: cannot be read ({error.strerror})") from error
    return Sources(stamps, contents)


def stamps_of(source: Path, also: Iterable[str] = ()) -> dict[str, Stamp]:
    """Size and time of all files that a capture may be read from, and of others by their names.

    Of a capture that is a file, these are the file and those beside it that belong to it.

    Raises:
        OSError: a folder cannot be read.
    """
    source = source.absolute()
    folder = _folder(source)
    start = len(str(folder / "x")) - 1
    stamps = {
        entry.path[start:]: _stamp(entry.stat())
        for entry in (_beside(source) if source.is_file() else _walk(folder, set()))
    }
    for name in (*also, *ABOVE):
        if name not in stamps and (folder / name).is_file():
            stamps[name] = _stamp((folder / name).stat())
    return stamps


def _folder(source: Path) -> Path:
    return source.parent if source.is_file() else source


def _stamp(found: os.stat_result) -> Stamp:
    return found.st_size, found.st_mtime_ns


def _beside(source: Path) -> Iterator[os.DirEntry[str]]:
    """A capture's file, and what belongs to it by its name."""
    own = (f"{source.stem}.", f"{source.stem}_")
    for entry in _readable(source.parent):
        if entry.is_file() and (entry.name.startswith(own) or entry.name in COMPANIONS):
            yield entry


def _walk(folder: Path, above: set[tuple[int, int]]) -> Iterator[os.DirEntry[str]]:
    """All files in a folder, however deep, links followed (but not in circles)."""
    found = folder.stat()
    place = (found.st_dev, found.st_ino)
    if place in above:
        return
    for entry in _readable(folder):
        if entry.is_dir():
            yield from _walk(Path(entry.path), above | {place})
        elif entry.is_file():  # not a link to nowhere
            yield entry


def _readable(folder: Path) -> Iterator[os.DirEntry[str]]:
    """What lies in a folder and may be read by a reader."""
    with os.scandir(folder) as entries:
        for entry in entries:
            name = entry.name
            read = not name.lower().endswith(NEVER_READ) or name.endswith(OFFICIAL)
            if read and not name.startswith("."):
                yield entry


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:32]
