"""Finding shards: paths, patterns and URLs to the shards they name, and what those must hold."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import braceexpand
import webdataset

from tf_lab.data.shards import FORMAT, INDEX
from tf_lab.errors import TFLabError
from tf_lab.support.documents import parse_json
from tf_lab.support.records import record
from tf_lab.support.text import MAX_TEXT

_NAME = re.compile(r"chunks-\d{6,}\.tar")
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")


@dataclass(frozen=True)
class Shard:
    """A shard, and what its index says of it."""

    url: str
    records: int
    bytes: int
    sha256: str


@dataclass(frozen=True)
class IndexEntry:
    """What an index says of a shard."""

    name: str
    records: int
    bytes: int
    sha256: str

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name) or self.records < 1:
            raise ValueError(f"a shard {self.name} of {self.records} chunks")


@dataclass(frozen=True)
class Index:
    """What ``shards.json`` holds."""

    format: int
    shards: list[IndexEntry]
    settings: dict[str, bool | int | float]


@dataclass(frozen=True)
class ShardSet:
    """Some shards, and how their chunks were drawn.

    Attributes:
        shards: in the order given.
        settings: of `ChunkSettings`, those that shape a record; and ``near``, ``far``.
    """

    shards: tuple[Shard, ...]
    settings: dict[str, Any]

    @property
    def records(self) -> int:
        """How many chunks there are."""
        return sum(shard.records for shard in self.shards)

    @property
    def identity(self) -> str:
        """A short hash of the contents, the same wherever the shards lie."""
        contents = " ".join(shard.sha256 for shard in self.shards)
        return hashlib.sha256(contents.encode()).hexdigest()[:16]


def open_shards(urls: str | Sequence[str]) -> ShardSet:
    """The shards that paths or URLs name; only their indices are read.

    Args:
        urls: each one a directory or an index (all its shards), a shard, or many by braces
            (``chunks-{000000..000031}.tar``) or, of files, by wildcards. What webdataset opens:
            paths, http(s), s3 and the like by ``pipe:aws s3 cp s3://bucket/NAME -``, where the
            index has the name of the shards replaced by shards.json.

    Raises:
        TFLabError: shards or their index are missing, damaged or of another version, or they were
            not drawn alike.
    """
    wanted: dict[str, list[str]] = {}  # names by index; none: all of them
    for url in dict.fromkeys(_expand([urls] if isinstance(urls, str) else urls)):
        if INDEX in url:
            wanted.setdefault(url, [])
            continue
        names = list(_NAME.finditer(url))
        if not names:
            raise TFLabError(f"{url}: not a shard; they are called chunks-000000.tar and so on")
        start, end = names[-1].span()
        wanted.setdefault(url[:start] + INDEX + url[end:], []).append(url[start:end])
    if not wanted:
        raise TFLabError("data.urls is empty; give a directory of shards, or their URLs")
    opened = [_open(index, names) for index, names in wanted.items()]
    settings = opened[0].settings
    for index, other in zip(wanted, opened, strict=True):
        if other.settings != settings:
            raise TFLabError(f"{index}: drawn with {other.settings}, the others with {settings}")
    return ShardSet(tuple(s for part in opened for s in part.shards), settings)


def _expand(urls: Sequence[str]) -> Iterator[str]:
    """The URL of every shard or index that is meant."""
    for url in urls:
        try:
            expanded = list(braceexpand.braceexpand(url))
        except ValueError as error:
            raise TFLabError(f"{url}: the braces cannot be read ({error})") from error
        for one in expanded:
            if _SCHEME.match(one):
                yield one + INDEX if one.endswith("/") else one
                continue
            path = Path(one).expanduser().absolute()
            if path.is_dir():
                yield str(path / INDEX)
            elif any(c in one for c in "*?["):
                found = sorted(Path(path.anchor).glob(str(path.relative_to(path.anchor))))
                shards = [str(match) for match in found if _NAME.fullmatch(match.name)]
                if not shards:
                    raise TFLabError(
                        f"data.urls={url}: there is no such shard; give a directory of shards, or "
                        "their URLs"
                    )
                yield from shards
            else:
                yield str(path)


def _open(url: str, names: Sequence[str]) -> ShardSet:
    """The shards of an index; of some names, or all."""
    head, _, tail = url.rpartition(INDEX)
    try:
        index = record(Index, _read(url))
        if index.format != FORMAT:
            raise TFLabError(
                f"{url}: shards of format {index.format}, expected {FORMAT}; write them again"
            )
        known = {
            entry.name: Shard(head + entry.name + tail, entry.records, entry.bytes, entry.sha256)
            for entry in index.shards
        }
    except ValueError as error:
        raise TFLabError(f"{url}: damaged ({error}); write the shards again") from error
    settings = index.settings
    for name in names:
        if name not in known:
            raise TFLabError(f"{head + name + tail}: not in {INDEX}, which knows {len(known)}")
    shards = tuple(known[name] for name in names or known)
    for shard in shards:
        _check_file(shard)
    return ShardSet(shards, settings)


def _read(url: str) -> Any:
    try:
        with webdataset.gopen(url) as stream:
            return parse_json(stream.read(MAX_TEXT))
    except Exception as error:  # whatever opens it, and whatever is in it
        raise TFLabError(
            f"{url}: the index of the shards cannot be read ({error}); either the place is wrong, "
            "or the shards are not finished: the command that writes them goes on where it stopped"
        ) from error


def _check_file(shard: Shard) -> None:
    """That a shard on this machine is there as a whole."""
    if _SCHEME.match(shard.url):
        return
    try:
        size = Path(shard.url).stat().st_size
    except OSError as error:
        raise TFLabError(f"{shard.url}: {error.strerror}; copy or write the shard again") from error
    if size != shard.bytes:
        raise TFLabError(
            f"{shard.url}: has {size} of {shard.bytes} bytes; delete it and write or copy it again"
        )
