"""What a data source is."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tf_lab.data.chunk_sampler import ChunkSampler
from tf_lab.data.chunks import ChunkSource
from tf_lab.data.settings import ChunkSettings
from tf_lab.data.shard_set import open_shards
from tf_lab.data.shard_stream import ShardSource
from tf_lab.data.sources import SOURCES
from tf_lab.data.sources.settings import SPLITS, Content
from tf_lab.data.stereo_maps import prepare_stereo
from tf_lab.errors import TFLabError

log = logging.getLogger(__name__)
ATTRIBUTION = "ATTRIBUTION.txt"  # beside scenes and shards whose images have to come with it


@dataclass(frozen=True)
class Prepared:
    """What preparing the scenes of some splits gave.

    Attributes:
        scenes: directories by split and name.
        failed: why which scene could not be made.
        summary: what was made and skipped, as text; "": nothing to say.
    """

    scenes: dict[str, dict[str, Path]]
    failed: dict[str, str]
    summary: str = ""


class DataSource(ABC):
    """Where the scenes of the splits "train", "val" and "test" come from.

    A scene is a directory that `tf_lab.data.scene.write_scene` wrote, with its ground truth
    (`tf_lab.data.groundtruth.write_groundtruth`).

    Args:
        settings: of this source, with at least ``name`` and ``root``.
        content: what was found in the data when the run began; then exactly that is used,
            whatever happens to the data meanwhile.
    """

    group = "data"  # that the settings are of, for messages

    def __init__(self, settings: Any, content: Content | None = None) -> None:
        self.settings, self.known = settings, content or Content()

    @property
    def root(self) -> Path:
        """Where the data lies."""
        return Path(self.settings.root).expanduser()

    @property
    def workers(self) -> int | None:
        """Processes that make scenes; None: one a core, also where a source has no such setting."""
        return getattr(self.settings, "workers", None)

    @property
    def size(self) -> tuple[int, int] | None:
        """(width, height) that images are brought to; None: a source has no such settings."""
        width, height = (getattr(self.settings, name, None) for name in ("width", "height"))
        return None if width is None or height is None else (width, height)

    @abstractmethod
    def prepare(self, splits: Sequence[str], check: bool = False) -> Prepared:
        """Make the scenes of splits that are missing or outdated; one that fails stops no other.

        Args:
            splits: of "train", "val" and "test".
            check: whether to look for cameras that are clearly wrong.
        """

    @abstractmethod
    def has(self, split: str) -> bool:
        """Whether a split has a scene, made or still to be made.

        Raises:
            TFLabError: those asked for are not there.
        """

    @abstractmethod
    def content(self, splits: Sequence[str] = SPLITS) -> Content:
        """What is in the data. Makes the scenes first where that says it.

        Args:
            splits: whose scenes are used; what is said of others does not matter.

        Raises:
            TFLabError: the scenes cannot be made, or the shards not be opened.
        """

    @abstractmethod
    def directory(self, name: str, digest: str | None) -> Path:
        """Where a test scene lies, if it has been made on this machine.

        Args:
            name: of the scene.
            digest: of its sources, as the run has it (`Content.scenes`).
        """

    def scenes(self, *splits: str) -> dict[str, dict[str, Path]]:
        """Scene directories by split and name, made first if they are missing.

        Those that cannot be made are logged and left out.

        Raises:
            TFLabError: a split has scenes, and none can be made.
        """
        return self.usable(self.prepare(splits))

    def usable(self, prepared: Prepared) -> dict[str, dict[str, Path]]:
        """The scenes of what was prepared, the failed ones logged; raises as `scenes`."""
        for name, reason in prepared.failed.items():
            log.warning("scene %s is left out: %s", name, reason)
        for split, found in prepared.scenes.items():
            if not found and self.has(split):
                raise TFLabError(f"none of the {split} scenes can be prepared, see above")
        return prepared.scenes

    def attribution(self) -> str | None:
        """Whom images of the training scenes have to name, if anybody; see `ATTRIBUTION`."""
        return None

    def shards(self) -> str | None:
        """The digest of the shards that training uses; None: it uses the training scenes.

        Raises:
            TFLabError: they cannot be opened.
        """
        urls = getattr(self.settings, "urls", None)
        return None if urls is None else open_shards(urls).identity

    def chunks(
        self, settings: ChunkSettings, near: float, far: float, stereo: bool = False
    ) -> ChunkSource:
        """Where training chunks come from: the shards ``data.urls``, or the training scenes.

        Args:
            settings: how chunks are drawn.
            near: least depth at which a view measures, metres.
            far: greatest, metres.
            stereo: whether the images' depth maps are wanted.

        Raises:
            TFLabError: the shards cannot be opened, or the scenes not be made.
        """
        if (urls := getattr(self.settings, "urls", None)) is not None:
            if stereo:
                raise TFLabError(
                    "inputs.stereo=true: shards hold no depth maps; train on the scenes"
                )
            return ShardSource(urls, settings, near, far, self.settings.shuffle, self.size)
        return self.sampler(settings, near, far, stereo)

    def sampler(
        self, settings: ChunkSettings, near: float, far: float, stereo: bool = False
    ) -> ChunkSampler:
        """Draws chunks of the training scenes, which are made first if they are missing."""
        scenes = [*self.scenes("train")["train"].values()]
        if stereo:
            prepare_stereo(scenes, settings.camera_noise, self.workers)
        return ChunkSampler(scenes, settings, near, far, stereo)


def open_source(settings: Any, content: Content | None = None, group: str = "data") -> DataSource:
    """The data source of settings; arguments as of `DataSource`.

    Args:
        settings: see `DataSource`.
        content: see `DataSource`.
        group: of the config that the settings are; messages name it.
    """
    source: DataSource = SOURCES.named(settings).load()(settings, content)
    source.group = group
    return source
