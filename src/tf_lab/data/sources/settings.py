"""Settings of the data sources that come with tf_lab, and what is found out about their data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tf_lab.data.reading import AS_STATED, ReadSettings
from tf_lab.data.settings import MOST_SIDE
from tf_lab.support.settings import setting

SPLITS = ("train", "val", "test")
CACHE = "${oc.env:TF_LAB_CACHE,${oc.env:XDG_CACHE_HOME,${oc.env:HOME,.}/.cache}/tf_lab}"

URLS = (
    "shards to train on instead of the training scenes: DIR, https://host/DIR/, "
    "'DIR/chunks-{000000..000031}.tar', or a list of such"
)
SHUFFLE = "of shards: an order of its own for every epoch"


@dataclass(frozen=True)
class Content:
    """What is in the data and the files that a run uses; found out when it starts.

    What is the same by content is the same data, wherever it lies.
    """

    versions: dict[str, int] = setting(
        {}, "of what makes embedded data and ground truth", shapes="weights"
    )
    train: str | None = setting(None, "digest of the training scenes", shapes="weights")
    test: str | None = setting(None, "digest of the test scenes", shapes="scores")
    groundtruth: str | None = setting(
        None, "digest of the ground truth that scenes are scored by", shapes="scores", absent=None
    )
    shards: str | None = setting(None, "digest of the shards", shapes="weights")
    init: str | None = setting(None, "digest of what training starts from", shapes="weights")
    encoder: str | None = setting(None, "digest of the encoder's first weights", shapes="weights")
    stereo: str | None = setting(
        None,
        "digest of what finds depth by stereo, if that is an input",
        shapes="weights",
        absent=None,
    )
    furniture: str | None = setting(
        None, "digest of the catalogues of furniture", shapes="weights", absent=None
    )
    textures: str | None = setting(
        None, "digest of the photographs of surfaces", shapes="weights", absent=None
    )
    scenes: dict[str, dict[str, str]] = setting(
        {}, "digests of captures' scenes, by split and name"
    )


@dataclass(frozen=True)
class EmbeddedData:
    """Scenes of our own, rendered on first use into a cache."""

    name: str
    root: str = setting(CACHE, "the cache; TF_LAB_CACHE moves it for all", kind="path")
    size: int = setting(32, "training scenes; hundreds for a real study", shapes="weights", least=0)
    val_size: int = setting(1, "val scenes, for the score while training", least=0)
    test_size: int = setting(4, "test scenes", shapes="scores", least=0)
    width: int = setting(160, "pixels", shapes="weights", least=1, most=MOST_SIDE)
    height: int = setting(120, "pixels", shapes="weights", least=1, most=MOST_SIDE)
    frames: int = setting(128, "of a training scene", shapes="weights", least=1)
    test_frames: int = setting(260, "of a val or test scene", shapes="scores", least=1)
    furniture: str | None = setting(
        None,
        "folder of Sweet Home 3D catalogues (.sh3f), whose models stand in training scenes; "
        "null: furniture of our own alone",
        kind="path",
    )
    textures: str | None = setting(
        None,
        "Sweet Home 3D's catalogue of textures (.sh3t, sweethome3d.jar), or a folder of such, "
        "whose photographs cover surfaces in training scenes; null: painted ones alone",
        kind="path",
    )
    workers: int | None = setting(None, "rendering processes; null: one a core", least=1)
    urls: Any = setting(None, URLS, kind="path", several=True)
    shuffle: bool = setting(True, SHUFFLE, shapes="weights", absent=True)


@dataclass(frozen=True)
class RoomsData(EmbeddedData):
    """Synthetic rooms, rendered on first use into the cache."""

    name: str = setting("rooms", "set it by data=", shapes="weights")


@dataclass(frozen=True)
class FlatsData(EmbeddedData):
    """Synthetic flats of one to five rooms, rendered on first use into the cache."""

    name: str = setting("flats", "set it by data=", shapes="weights")
    frames: int = setting(
        70, "of a training flat, for each of its rooms", shapes="weights", least=1
    )
    test_frames: int = setting(
        230, "of a val or test flat, for each of its rooms", shapes="scores", least=1
    )
    rooms: int = setting(
        0, "single rooms to train on beside the flats, as of data=rooms", shapes="weights", least=0
    )


@dataclass(frozen=True)
class PreparedData:
    """Scenes that are prepared from captures: from what a camera recorded."""

    name: str
    root: str
    scenes: str = setting("${.root}/tf_lab", "where the prepared scenes go", kind="path")
    width: int = setting(640, "pixels", shapes="weights", least=1, most=MOST_SIDE)
    height: int = setting(480, "pixels", shapes="weights", least=1, most=MOST_SIDE)
    keyframe_distance: float = setting(
        0.1, "pose distance between stored frames; 0: all", shapes="weights", least=0
    )
    size: int | None = setting(None, "use so many of the training scenes; null: all", least=0)
    val_size: int | None = setting(None, "use so many of the val scenes; null: all", least=0)
    test_size: int | None = setting(None, "use so many of the test scenes; null: all", least=0)
    workers: int | None = setting(None, "processes, one a scene; null: one a core", least=1)
    memory: float = setting(1.0, "GiB a process may take for depth fusion", above=0)
    urls: Any = setting(None, URLS, kind="path", several=True)
    shuffle: bool = setting(True, SHUFFLE, shapes="weights")

    @property
    def read(self) -> ReadSettings:
        """How the captures are read."""
        return ReadSettings.part_of(self) if isinstance(self, ReadSettings) else AS_STATED


@dataclass(frozen=True)
class CapturesData(ReadSettings, PreparedData):
    """Your own posed RGB-D captures, each a folder (or file) in a layout of docs/data.md."""

    name: str = setting("captures", "set it by data=", shapes="weights")
    root: str = setting("???", "the folder that holds the captures", kind="path")
    train: Any = setting(
        None,
        "scene names, or a text file with one a line; null: all but val and test",
        kind="source",
        several=True,
    )
    val: Any = setting(
        [], "scene names, likewise, for the score while training", kind="source", several=True
    )
    test: Any = setting(
        [],
        "scene names, likewise; without a test scene there is no score",
        kind="source",
        several=True,
    )


@dataclass(frozen=True)
class ScanNetData(ReadSettings, PreparedData):
    """ScanNet v2 with the official splits, as in the paper. docs/data.md says what to download."""

    name: str = setting("scannet", "set it by data=", shapes="weights")
    root: str = setting("data/scannet", "holds scans/ and scans_test/", kind="path")
    val_size: int | None = setting(
        10, "of those there, for the score while training; null: all", least=0
    )
