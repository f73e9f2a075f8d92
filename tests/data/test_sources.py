"""All data sources against the contract, on a few small scenes each."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pytest

from helpers import small_shards
from helpers.layouts import plain, room_frames, scannet
from tf_lab.data.sources import SOURCES
from tf_lab.data.sources.contract import CHECKS
from tf_lab.data.sources.settings import (
    CapturesData,
    Content,
    FlatsData,
    RoomsData,
    ScanNetData,
)
from tf_lab.data.sources.source import DataSource, Prepared, open_source
from tf_lab.errors import TFLabError

Check = Callable[[Any], None]
SIZE: dict[str, Any] = {"width": 64, "height": 48, "workers": 1}
EMBEDDED: dict[str, Any] = {**SIZE, "size": 2, "val_size": 0, "frames": 12, "test_frames": 12}
# of ScanNet's splits
BESIDE_SHARDS = ("rooms and shards", "flats and shards")
SCANS = {
    "train": "scans/scene0000_00",
    "val": "scans/scene0011_00",
    "test": "scans_test/scene0707_00",
}


@pytest.fixture(scope="module", autouse=True)
def no_processes() -> Iterator[None]:
    """Scenes are made in this process: starting others takes longer than making so small ones."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("tf_lab.support.tasks", "tf_lab.data.prepare_captures"):
            patch.setattr(f"{module}.run_tasks", small_shards.run_here)
        yield


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory, box_scene: Path) -> dict[str, Any]:
    """Small settings of every source, by name; their scenes are made once."""
    root = tmp_path_factory.mktemp("sources")
    cache = {"root": str(root / "cache"), "test_size": 1}
    for name in ("hall", "kitchen", "office"):
        plain.write(root / "captures" / name, room_frames())
    for folder in SCANS.values():
        scannet.write(root / "scannet" / folder, room_frames())
    for split, folder in SCANS.items():
        names = root / "scannet" / f"scannetv2_{split}.txt"
        names.write_text(f"{Path(folder).name}\n")
    small_shards.write(root / "shards", small_shards.sampler(box_scene))
    return {
        "rooms": RoomsData(**EMBEDDED, **cache),
        "flats": FlatsData(**{**EMBEDDED, "size": 1}, **cache, rooms=1),
        "rooms and shards": RoomsData(**EMBEDDED, **cache, urls=str(root / "shards")),
        "flats and shards": FlatsData(**EMBEDDED, **cache, urls=str(root / "shards"), rooms=1),
        "captures": CapturesData(
            **SIZE,
            root=str(root / "captures"),
            scenes=str(root / "prepared"),
            test=["office"],
        ),
        "scannet": ScanNetData(
            **SIZE, root=str(root / "scannet"), scenes=str(root / "prepared_scannet")
        ),
    }


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", [*(p.name for p in SOURCES), *BESIDE_SHARDS])
def test_contract(settings: dict[str, Any], name: str, check: Check) -> None:
    check(settings[name])


def test_rooms_beside_the_flats_are_those_of_data_rooms(settings: dict[str, Any]) -> None:
    source = open_source(settings["flats"])
    assert [*source.scenes("train")["train"]] == ["flat_0000000", "room_0000000"]
    assert [*source.scenes("test")["test"]] == ["flat_2000000"]
    alone = RoomsData(**SIZE, size=1, root=settings["flats"].root)
    room = open_source(alone).scenes("train")["train"]["room_0000000"]
    assert source.scenes("train")["train"]["room_0000000"] == room
    assert source.content().versions == {
        **open_source(alone).content().versions,
        **open_source(FlatsData(root=alone.root)).content().versions,
    }


@dataclass(frozen=True)
class OwnData:
    """What a source has to have, and no more."""

    name: str = "own"
    root: str = "."


class OwnSource(DataSource):
    """One training scene that fails, and perhaps one that does not."""

    good: ClassVar[dict[str, Path]] = {}

    def prepare(self, splits: Sequence[str], check: bool = False) -> Prepared:
        scenes = {split: self.good if split == "train" else {} for split in splits}
        return Prepared(scenes, {"bad": "NaN in it"} if "train" in splits else {})

    def has(self, split: str) -> bool:
        return split == "train"

    def content(self) -> Content:
        return Content()

    def directory(self, name: str, digest: str | None) -> Path:
        return self.root / name


def test_scenes_that_a_source_of_ones_own_cannot_make_are_told(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    source = OwnSource(OwnData())
    with pytest.raises(TFLabError, match="none of the train scenes can be prepared"):
        source.scenes("train")
    assert "scene bad is left out: NaN in it" in caplog.text
    monkeypatch.setattr(OwnSource, "good", {"hall": Path("hall")})
    assert source.scenes("train", "test") == {"train": {"hall": Path("hall")}, "test": {}}
    assert (source.workers, source.size) == (None, None)
