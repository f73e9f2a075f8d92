"""The embedded data sets: scenes rendered once into a cache, with ground truth from their depth."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from tf_lab.data import flats, groundtruth, rooms, scene
from tf_lab.data.flats import generate_flat
from tf_lab.data.groundtruth import GroundTruthSettings, write_groundtruth
from tf_lab.data.rooms import RoomSettings, generate_room, models, photographs
from tf_lab.data.rooms.borrowed import NOTHING, Borrowed
from tf_lab.data.rooms.catalogue import read_catalogue
from tf_lab.data.rooms.photographs import read_photographs
from tf_lab.data.scene import Frame, write_scene
from tf_lab.data.sources.scene_jobs import SceneJob, build_scenes
from tf_lab.data.sources.settings import SPLITS, Content, EmbeddedData, FlatsData, RoomsData
from tf_lab.data.sources.source import ATTRIBUTION, DataSource, Prepared
from tf_lab.errors import TFLabError
from tf_lab.support.files import atomic_path, file_name

ALIKE = ("root", "width", "height", "workers", "furniture", "textures")  # of rooms beside flats
FIRST_SEED = {"train": 0, "val": 1_000_000, "test": 2_000_000}  # splits never share a scene


@dataclass(frozen=True)
class EmbeddedSplit:
    """How many scenes a split has, how they are filmed, and what of them others made."""

    size: int
    settings: RoomSettings
    borrowed: Borrowed = NOTHING


@dataclass(frozen=True)
class EmbeddedSet:
    """A data set that is made from seeds.

    Attributes:
        name: of the data group; a plural.
        version: changes whenever the output for the same seed does.
        generate: films the scene of a seed.
    """

    name: str
    version: int
    generate: Callable[[int, RoomSettings, Borrowed], Iterator[Frame]]

    def scene_name(self, seed: int) -> str:
        """As in ``room_0000003``."""
        return f"{self.name.removesuffix('s')}_{seed:07d}"

    def directory(
        self,
        root: Path,
        split: str,
        index: int,
        settings: RoomSettings,
        borrowed: Borrowed = NOTHING,
    ) -> Path:
        """Where a scene lies: all that shapes it is in the path, so a cache never goes stale."""
        shaped: list[Any] = [self.version, scene.FORMAT, groundtruth.VERSION]
        shaped += [asdict(settings), asdict(GroundTruthSettings())]
        shaped += borrowed.identity
        identity = json.dumps(shaped)
        key = hashlib.sha256(identity.encode()).hexdigest()[:10]
        return root / f"{self.name}-{key}" / split / self.scene_name(FIRST_SEED[split] + index)

    def _build(
        self, seed: int, settings: RoomSettings, borrowed: Borrowed, directory: Path
    ) -> None:
        """Render a scene and its ground truth into a directory (see `scene`, `groundtruth`)."""
        provenance = {
            "source": self.name,
            "seed": seed,
            "version": self.version,
            **asdict(settings),
            **({"borrowed": borrowed.identity} if borrowed.identity else {}),
        }
        frames = self.generate(seed, settings, borrowed)
        made = write_scene(directory, frames, provenance, name=self.scene_name(seed))
        write_groundtruth(made, made.groundtruth, GroundTruthSettings())

    def prepare(
        self, root: Path, splits: Mapping[str, EmbeddedSplit], workers: int | None = None
    ) -> dict[str, list[Path]]:
        """Render what is missing and return the scene directories of each split.

        Args:
            root: the cache.
            splits: by name: "train", "val", "test".
            workers: processes; None: one a core.
        """
        found: dict[str, list[Path]] = {}
        jobs = []
        for split, wanted in splits.items():
            film = wanted.settings, wanted.borrowed
            found[split] = [self.directory(root, split, i, *film) for i in range(wanted.size)]
            for seed, directory in enumerate(found[split], FIRST_SEED[split]):
                jobs.append(SceneJob(directory, partial(self._build, seed, *film)))
            if found[split]:
                self._attribute(found[split][0].parent.parent, wanted.borrowed)
        build_scenes(jobs, f"rendering {self.name}", workers)
        return found

    def _attribute(self, directory: Path, borrowed: Borrowed) -> None:
        """Say beside the scenes whose models and photographs are in them."""
        text = borrowed.attribution()
        if text is not None and not (directory / ATTRIBUTION).exists():
            directory.mkdir(parents=True, exist_ok=True)
            with atomic_path(directory / ATTRIBUTION) as temporary:
                temporary.write_text(text, encoding="utf-8")


ROOMS = EmbeddedSet("rooms", rooms.VERSION, generate_room)
FLATS = EmbeddedSet("flats", flats.VERSION, generate_flat)


class EmbeddedSource(DataSource):
    """Scenes of an embedded set, of which none can fail."""

    made: EmbeddedSet
    settings: EmbeddedData

    def prepare(self, splits: Sequence[str], check: bool = False) -> Prepared:
        """See `DataSource`."""
        wanted = {
            split: EmbeddedSplit(self._size(split), self._filming(split), self._borrowed(split))
            for split in splits
        }
        found = self.made.prepare(self.root, wanted, self.settings.workers)
        scenes = {split: {path.name: path for path in paths} for split, paths in found.items()}
        lines = [
            f"{split}: {len(paths)} {self.made.name} in {paths[0].parent}"
            for split, paths in found.items()
            if paths
        ]
        return Prepared(scenes, {}, "\n".join(lines))

    def has(self, split: str) -> bool:
        """See `DataSource`."""
        return self._size(split) > 0

    def content(self, splits: Sequence[str] = SPLITS) -> Content:
        """See `DataSource`."""
        versions = {"groundtruth": groundtruth.VERSION, self.made.name: self.made.version}
        if "train" not in splits:
            return Content(versions)
        furniture, textures = None, None
        borrowed = self._borrowed("train")
        if borrowed.furniture is not None:
            versions["furniture"], furniture = models.VERSION, borrowed.furniture.digest
        if borrowed.photographs is not None:
            versions["textures"], textures = photographs.VERSION, borrowed.photographs.digest
        return Content(versions, shards=self.shards(), furniture=furniture, textures=textures)

    def directory(self, name: str, digest: str | None) -> Path:
        """See `DataSource`."""
        known = self.made.directory(self.root, "test", 0, self._filming("test"))
        return known.with_name(file_name(name))

    def _size(self, split: str) -> int:
        s = self.settings
        train = s.size if s.urls is None else 0
        return {"train": train, "val": s.val_size, "test": s.test_size}[split]

    def _borrowed(self, split: str) -> Borrowed:
        """Val and test scenes are the same for all, so that their scores compare."""
        s = self.settings
        if split != "train" or s.urls is not None:
            return NOTHING
        furniture = read_catalogue(Path(s.furniture).expanduser()) if s.furniture else None
        covers = read_photographs(Path(s.textures).expanduser()) if s.textures else None
        for name, found in (("furniture", furniture), ("textures", covers)):
            if found is not None and getattr(self.known, name) not in (None, found.digest):
                raise TFLabError(
                    f"data.{name}={getattr(s, name)}: other catalogues than when this run began; "
                    "start it again"
                )
        return Borrowed(furniture, covers)

    def attribution(self) -> str | None:
        """See `DataSource`."""
        return self._borrowed("train").attribution()

    def _filming(self, split: str) -> RoomSettings:
        s = self.settings
        return RoomSettings(s.width, s.height, s.frames if split == "train" else s.test_frames)


class RoomSource(EmbeddedSource):
    """Synthetic rooms."""

    made = ROOMS


class FlatSource(EmbeddedSource):
    """Synthetic flats, and single rooms beside them where training asks for it."""

    made = FLATS
    settings: FlatsData

    def prepare(self, splits: Sequence[str], check: bool = False) -> Prepared:
        """See `DataSource`."""
        found = super().prepare(splits, check)
        if "train" not in splits or not self._beside():
            return found
        rooms = self._rooms().prepare(["train"])
        train = {**found.scenes["train"], **rooms.scenes["train"]}
        summary = f"{found.summary}\n{rooms.summary}".strip()
        return Prepared({**found.scenes, "train": train}, {}, summary)

    def has(self, split: str) -> bool:
        """See `DataSource`."""
        return super().has(split) or (split == "train" and self._beside() > 0)

    def content(self, splits: Sequence[str] = SPLITS) -> Content:
        """See `DataSource`."""
        content = super().content(splits)
        if "train" not in splits or not self._beside():
            return content
        return replace(content, versions={**content.versions, **self._rooms().content().versions})

    def _beside(self) -> int:
        """How many single rooms are trained on."""
        return self.settings.rooms if self.settings.urls is None else 0

    def _rooms(self) -> RoomSource:
        s = self.settings
        same = {k: getattr(s, k) for k in ALIKE}
        return RoomSource(RoomsData(size=s.rooms, **same))
