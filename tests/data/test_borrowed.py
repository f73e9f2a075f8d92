"""What others made: in training scenes alone, known by its content, its makers named."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from helpers.catalogues import write_furniture, write_textures
from tf_lab.data.sources.embedded import FlatSource, RoomSource
from tf_lab.data.sources.settings import Content, FlatsData, RoomsData
from tf_lab.data.sources.source import ATTRIBUTION
from tf_lab.errors import TFLabError

SETS = {"furniture": (write_furniture, "Oak wardrobe"), "textures": (write_textures, "Oak boards")}


def source(cache: Path, **settings: str) -> RoomSource:
    size = {"size": 1, "val_size": 1, "test_size": 0, "width": 32, "height": 24}
    frames = {"frames": 12, "test_frames": 12}
    return RoomSource(RoomsData(root=str(cache), workers=1, **size, **frames, **settings))


@pytest.mark.parametrize("setting", SETS)
def test_training_scenes_alone(setting: str, tmp_path: Path) -> None:
    """And say whose it is; wherever the catalogues lie, the same content is the same data."""
    write, name = SETS[setting]
    here, there, cache = write(tmp_path / "here"), tmp_path / "there", tmp_path / "cache"
    shutil.copytree(here, there)
    plain, given = source(cache), source(cache, **{setting: str(here)})
    prepared = [s.prepare(["train", "val"]).scenes for s in (plain, given)]
    (plain_train,), (train,) = (p["train"].values() for p in prepared)
    assert prepared[0]["val"] == prepared[1]["val"]
    assert plain_train != train
    assert name in (train.parent.parent / ATTRIBUTION).read_text(encoding="utf-8")
    assert not (plain_train.parent.parent / ATTRIBUTION).exists()
    copied = source(cache, **{setting: str(there)})
    assert copied.prepare(["train"]).scenes["train"] == prepared[1]["train"]
    assert getattr(plain.content(), setting) is None
    assert plain.attribution() is None
    assert name in str(given.attribution())
    assert given.content() == copied.content()
    assert given.content() != plain.content()
    assert given.content(("val", "test")) == plain.content(("val", "test"))


@pytest.mark.parametrize("setting", SETS)
def test_others_than_when_a_run_began(setting: str, tmp_path: Path) -> None:
    write: Callable[[Path], Path] = SETS[setting][0]
    data = RoomsData(root=str(tmp_path), **{setting: str(write(tmp_path / "borrowed"))})
    with pytest.raises(TFLabError, match=rf"data\.{setting}=.*other catalogues than when this run"):
        RoomSource(data, Content(**{setting: "another"})).prepare(["train"])


def test_both_together_and_in_rooms_beside_flats(tmp_path: Path) -> None:
    places = {name: str(write(tmp_path / name)) for name, (write, _) in SETS.items()}
    data = FlatsData(root=str(tmp_path), rooms=1, **places)
    text = str(FlatSource(data).attribution())
    assert all(name in text for _, name in SETS.values())
    assert FlatSource(data)._rooms().settings.textures == data.textures
    alone = FlatSource(FlatsData(root=str(tmp_path), furniture=places["furniture"]))
    assert FlatSource(data).content() != alone.content()
