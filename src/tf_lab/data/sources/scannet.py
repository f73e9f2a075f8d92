"""ScanNet v2 as a data source: its official splits."""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from pathlib import Path

from tf_lab.data.prepare_captures import scene_of
from tf_lab.data.scannet_splits import find_scene, official_mesh, split_scenes
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
        limits = {"train": s.size, "val": s.val_size, "test": s.test_size}
        names = {k: split_scenes(self.root, k) if n != 0 else [] for k, n in limits.items()}
        shared = {*names["val"], *names["test"]}.intersection(names["train"])
        if shared:
            raise TFLabError(
                f"{self.group}.root={self.root}: {min(shared)} is in the list of the train scenes, "
                "and held out for val or test as well; take it from one of scannetv2_*.txt"
            )
        return {split: self._split(split, names[split], limits[split]) for split in splits}

    def _split(self, split: str, names: Collection[str], limit: int | None) -> dict[str, Path]:
        """The first of a split's scenes that are there; says how many are missing."""
        found: dict[str, Path] = {}
        missing: list[TFLabError] = []
        for name in names:
            if len(found) == limit:
                break
            try:
                found[name] = find_scene(self.root, name)
            except TFLabError as error:
                if scene_of(self.folder / name):
                    found[name] = self.root / name  # prepared, when it was there
                else:
                    missing.append(error)
        if names and not found:
            there = self.root.exists()
            where = f"no {split} scene in it" if there else "there is no such folder"
            without = "" if split == "train" else f"{self.group}.{split}_size=0 goes without, "
            raise TFLabError(
                f"{self.group}.root={self.root}: {where}; {without}a list of your "
                f"own in scannetv2_{split}.txt there says which they are; {missing[0]}"
            )
        if missing and (limit is None or len(found) < limit):
            message = "%d of %d %s scenes are missing: %s"
            log.warning(message, len(missing), len(names), split, missing[0])
        bare = [n for n, path in found.items() if path.exists() and official_mesh(path) is None]
        if bare:
            message = (
                "%d of %d %s scenes have no official mesh, the first: %s; their ground truth is "
                "fused from depth, that of others is the mesh"
            )
            log.warning(message, len(bare), len(found), split, found[bare[0]])
        return found
