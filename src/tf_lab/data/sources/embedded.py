"""The embedded data sets: scenes rendered once into a cache, with ground truth from their depth."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from tf_lab.data import flats, groundtruth, rooms, scene
from tf_lab.data.flats import generate_flat
from tf_lab.data.groundtruth import GroundTruthSettings, write_groundtruth
from tf_lab.data.rooms import RoomSettings, generate_room, models, photographs
from tf_lab.data.rooms.borrowed import NOTHING, Borrowed
from tf_lab.data.rooms.catalogue import read_catalogue
from tf_lab.data.rooms.photographs import read_photographs
from tf_lab.data.scene import Frame, write_scene
from tf_lab.data.sources.scene_jobs import build_scenes
from tf_lab.data.sources.settings import SPLITS, Content, EmbeddedData, FlatsData, RoomsData
from tf_lab.data.sources.source import ATTRIBUTION, DataSource, Prepared
from tf_lab.errors import TFLabError
from tf_lab.support.files import file_name, write_text
from tf_lab.support.hashes import hash_of

ALIKE = ("root", "width", "height", "workers", "furniture", "textures")  # of rooms beside flats
FIRST_SEED = {"train": 0, "val": 1_000_000, "test": 2_000_000}  # splits never share a scene


class EmbeddedSource(DataSource):
    """Scenes that are made from seeds, of which none can fail.

    Attributes:
        name: of the data group; a plural.
        version: changes whenever the output for the same seed does.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    settings: EmbeddedData

    @abstractmethod
    def film(self, seed: int, settings: RoomSettings, borrowed: Borrowed) -> Iterator[Frame]:
        """The frames of the scene of a seed."""

    def prepare(self, splits: Sequence[str], check: bool = False) -> Prepared:
        """See `DataSource`."""
        scenes: dict[str, dict[str, Path]] = {}
        builders, lines = {}, []
        for split in splits:
            borrowed = self._borrowed(split)
            folder = self._folder(split, borrowed)
            seeds = range(FIRST_SEED[split], FIRST_SEED[split] + self._size(split))
            made = {seed: folder / self._scene_name(seed) for seed in seeds}
            scenes[split] = {path.name: path for path in made.values()}
            for seed, path in made.items():
                builders[path] = partial(self._build, seed, self._filming(split), borrowed)
            if made:
                self._attribute(folder.parent, borrowed)
                lines.append(f"{split}: {len(made)} {self.name} in {folder}")
        build_scenes(builders, f"rendering {self.name}", self.settings.workers)
        return Prepared(scenes, {}, "\n".join(lines))

    def _scene_name(self, seed: int) -> str:
        """As in ``room_0000003``."""
        return f"{self.name.removesuffix('s')}_{seed:07d}"

    def _folder(self, split: str, borrowed: Borrowed) -> Path:
        """Where a split's scenes lie; the path says what shapes them: a cache is never stale."""
        shaped: list[Any] = [self.version, scene.FORMAT, groundtruth.VERSION]
        shaped += [asdict(self._filming(split)), asdict(GroundTruthSettings())]
        shaped += borrowed.identity
        return self.root / f"{self.name}-{hash_of(shaped)}" / split

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
        frames = self.film(seed, settings, borrowed)
        made = write_scene(directory, frames, provenance, name=self._scene_name(seed))
        write_groundtruth(made, made.groundtruth, GroundTruthSettings())

    def _attribute(self, directory: Path, borrowed: Borrowed) -> None:
        """Say beside the scenes whose models and photographs are in them."""
        text = borrowed.attribution()
        if text is not None and not (directory / ATTRIBUTION).exists():
            write_text(directory / ATTRIBUTION, text)

    def has(self, split: str) -> bool:
        """See `DataSource`."""
        return self._size(split) > 0

    def content(self, splits: Sequence[str] = SPLITS) -> Content:
        """See `DataSource`."""
        versions = {"groundtruth": groundtruth.VERSION, self.name: self.version}
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
        return self._folder("test", NOTHING) / file_name(name)

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

    name, version = "rooms", rooms.VERSION

    def film(self, seed: int, settings: RoomSettings, borrowed: Borrowed) -> Iterator[Frame]:
        """See `EmbeddedSource`."""
        return generate_room(seed, settings, borrowed)


class FlatSource(EmbeddedSource):
    """Synthetic flats, and single rooms beside them where training asks for it."""

    name, version = "flats", flats.VERSION
    settings: FlatsData

    def film(self, seed: int, settings: RoomSettings, borrowed: Borrowed) -> Iterator[Frame]:
        """See `EmbeddedSource`."""
        return generate_flat(seed, settings, borrowed)

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
