"""Captures as a data source: a folder of posed RGB-D recordings, each made into a scene."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path

from tf_lab.data import groundtruth
from tf_lab.data.import_capture import ImportSettings
from tf_lab.data.prepare_captures import (
    PreparedCaptures,
    find_captures,
    names_of,
    prepare_captures,
    prepared_scenes,
    summarise,
)
from tf_lab.data.sources.settings import SPLITS, CapturesData, Content, PreparedData
from tf_lab.data.sources.source import DataSource, Prepared
from tf_lab.errors import TFLabError
from tf_lab.support.files import file_name
from tf_lab.support.hashes import hash_of

log = logging.getLogger(__name__)


class PreparedSource(DataSource):
    """Scenes that are prepared from captures; a source says which captures there are."""

    settings: PreparedData

    @abstractmethod
    def captures(self, splits: Sequence[str]) -> dict[str, dict[str, Path]]:
        """The captures of each split, by the name of their scene.

        Raises:
            TFLabError: the source is missing, or a split names what is not there.
        """

    @property
    def import_settings(self) -> ImportSettings:
        """How captures become scenes."""
        s = self.settings
        return ImportSettings(s.width, s.height, s.keyframe_distance, s.read)

    @property
    def folder(self) -> Path:
        """Where the scenes of these settings lie."""
        return Path(self.settings.scenes).expanduser() / self.import_settings.key

    def prepare(self, splits: Sequence[str], check: bool = False) -> Prepared:
        """See `DataSource`."""
        scenes, made = self._prepared(splits, check)
        return Prepared(scenes, made.failed, summarise(made, self.folder))

    def _prepared(
        self, splits: Sequence[str], check: bool = False
    ) -> tuple[dict[str, dict[str, Path]], PreparedCaptures]:
        s, chosen = self.settings, self.captures(splits)
        sources = {name: path for split in chosen.values() for name, path in split.items()}
        root, memory = Path(s.scenes).expanduser(), round(s.memory * 2**30)
        made = prepare_captures(
            *(sources, root, self.import_settings, s.workers, memory, check),
            what=f"{self.group}.scenes",
        )
        scenes = {
            split: {name: made.scenes[name] for name in names if name in made.scenes}
            for split, names in chosen.items()
        }
        return scenes, made

    def has(self, split: str) -> bool:
        """See `DataSource`."""
        return bool((self.known.scenes or self.captures((split,))).get(split))

    def scenes(self, *splits: str) -> dict[str, dict[str, Path]]:
        """See `DataSource`; a run that knows its scenes has those."""
        if table := self.known.scenes:
            return {s: {n: self.folder / n / d for n, d in table[s].items()} for s in splits}
        scenes, made = self._prepared(splits)
        return self.usable(Prepared(scenes, made.failed))

    def content(self, splits: Sequence[str] = SPLITS) -> Content:
        """See `DataSource`."""
        shards = self.shards() if "train" in splits else None
        splits = [split for split in splits if split != "train" or not shards]
        scenes = self.scenes(*splits)
        table = {s: {name: path.name for name, path in scenes[s].items()} for s in splits}
        key = self.import_settings.key
        digest = {s: hash_of([key, *table[s].items()], 16) for s in splits}
        versions = {"groundtruth": groundtruth.VERSION}
        train, test = digest.get("train"), digest.get("test")
        return Content(versions, train=train, test=test, shards=shards, scenes=table)

    def directory(self, name: str, digest: str | None) -> Path:
        """See `DataSource`."""
        return self.folder / file_name(name) / file_name(digest or "unknown")


class CaptureSource(PreparedSource):
    """The captures in a folder."""

    settings: CapturesData

    def captures(self, splits: Sequence[str]) -> dict[str, dict[str, Path]]:
        """See `PreparedSource`."""
        s, found = self.settings, self._find()
        named = {"train": s.train or [], "val": s.val, "test": s.test}
        names = {k: names_of(v or [], list(found), f"{self.group}.{k}") for k, v in named.items()}
        held_out = {*names["val"], *names["test"]}
        if s.train is None:
            names["train"] = [name for name in found if name not in held_out]
        shared = held_out.intersection(names["train"])
        if shared:
            raise TFLabError(
                f"{self.group}.train: {min(shared)} is held out for val or test as well"
            )
        limit = {"train": s.size, "val": s.val_size, "test": s.test_size}
        return {k: {name: found[name] for name in names[k][: limit[k]]} for k in splits}

    def _find(self) -> dict[str, Path]:
        """The captures in the root; of a root without any, those that scenes were prepared of."""
        try:
            return find_captures(self.root, f"{self.group}.root")
        except TFLabError:
            found = {name: self.root / name for name in prepared_scenes(self.folder)}
            if not found:
                raise
            message = "no capture in %s: the scenes prepared before are used, in %s"
            log.warning(message, self.root, self.folder)
            return found
