"""ScanNet v2 as a data source: its official splits."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from tf_lab.data.captures import scene_of
from tf_lab.data.scannet_splits import find_scene, split_scenes
from tf_lab.data.sources.captures import PreparedSource
from tf_lab.data.sources.settings import ScanNetData
from tf_lab.errors import TFLabError

log = logging.getLogger(__name__)


class ScanNetSource(PreparedSource):
    """The scenes of the official splits that are prepared or there to be."""

    settings: ScanNetData

    def captures(self, splits: Sequence[str]) -> dict[str, dict[str, Path]]:
        """See `PreparedSource`."""
        s = self.settings
        limit = {"train": s.size, "val": s.val_size, "test": s.test_size}
        return {split: self._split(split, limit[split]) for split in splits}

    def _split(self, split: str, limit: int | None) -> dict[str, Path]:
        """The scenes of a split; says how many are missing."""
        found, missing = {}, []
        names = split_scenes(self.root, split)[:limit]
        for name in names:
            try:
                found[name] = find_scene(self.root, name)
            except TFLabError as error:
                if scene_of(self.folder / name):
                    found[name] = self.root / name  # prepared, when it was there
                else:
                    missing.append(error)
        if names and not found:
            raise TFLabError(f"{self.group}.root={self.root}: no {split} scene in it; {missing[0]}")
        if missing:
            message = "%d of %d %s scenes are missing: %s"
            log.warning(message, len(missing), len(names), split, missing[0])
        return found
