"""Modelled furniture: read from catalogues, put where ours would stand, seen as it is."""

from __future__ import annotations

import logging
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers.catalogues import CABINET, MATERIALS, SIDES, front, write_furniture
from helpers.tiny_jobs import call
from tf_lab.data.rooms import RoomSettings, generate_room, make_room
from tf_lab.data.rooms.borrowed import Borrowed
from tf_lab.data.rooms.catalogue import Catalogue, read_catalogue
from tf_lab.data.rooms.decor import Kit, Piece
from tf_lab.data.rooms.materials import Textures, make_materials
from tf_lab.data.rooms.models import Furniture, read_parts
from tf_lab.data.rooms.render import Lighting, Renderer
from tf_lab.data.rooms.shapes import Surfaces
from tf_lab.data.rooms.textures import SIZE
from tf_lab.data.sources.embedded import RoomSource
from tf_lab.data.sources.settings import RoomsData
from tf_lab.data.sources.source import ATTRIBUTION
from tf_lab.errors import TFLabError


@pytest.fixture
def catalogue(tmp_path: Path) -> Catalogue:
    return read_catalogue(write_furniture(tmp_path / "furniture"))


def ours(name: str) -> Piece:
    def build(kit: Kit) -> None:
        raise AssertionError("the model is built")

    return Piece(name, 1.0, 1.0, 1.0, build)


def stand_in(furniture: Furniture, name: str = "wardrobe") -> Piece:
    """A model; pieces of ours stay with some probability."""
    pieces = (furniture.instead(ours(name)) for _ in range(100))
    return next(piece for piece in pieces if piece.height != 1.0)


def test_what_a_catalogue_says(catalogue: Catalogue) -> None:
    (model,) = catalogue.models
    assert (model.name, model.kind, model.maker) == ("Oak wardrobe", "wardrobe", "Somebody")
    assert model.size == (1.0, 0.5, 2.0)
    assert catalogue.of_kind("wardrobe") == [model]
    assert catalogue.of_kind("sofa") == []
    text = catalogue.attribution()
    assert "test.sh3f: Made up é" in text
    assert "- Oak wardrobe (made/cabinet/cabinet.obj), by Somebody" in text


@pytest.mark.parametrize(
    ("said", "kind"),
    [
        ("name#1=Couch\nwidth#1=200\ndepth#1=90\nheight#1=80", "sofa"),
        ("name#1=Armchair\nwidth#1=90\ndepth#1=80\nheight#1=80", "armchair"),
        ("name#1=Bedside table\nwidth#1=48\ndepth#1=48\nheight#1=45", "nightstand"),
        ("name#1=Table\nwidth#1=120\ndepth#1=60\nheight#1=45", "coffee table"),
        ("name#1=Table\nwidth#1=160\ndepth#1=90\nheight#1=75", "table"),
        ("name#1=Upright piano\nwidth#1=141\ndepth#1=54\nheight#1=138", "crates"),
        ("name#1=Pool table\nwidth#1=256\ndepth#1=139\nheight#1=82", None),
        ("name#1=Cup\nwidth#1=8\ndepth#1=8\nheight#1=10", None),
        ("name#1=Wall shelves\nelevation#1=120", None),
        ("category#1=Vehicles", None),
        ("doorOrWindow#1=true", None),
        ("name#1=Curtain", None),
        ("width#1=wide", None),
        ("modelRotation#1=1 0 0", None),
        ("model#1=/made/absent.obj", None),
    ],
)
def test_what_stands_in_for_what(tmp_path: Path, said: str, kind: str | None) -> None:
    """A line that comes later counts; a second entry is as it was, so that there is one."""
    second = CABINET.replace("#1=", "#2=")
    models = read_catalogue(write_furniture(tmp_path, CABINET + said + second)).models
    assert [model.kind for model in models] == [*([kind] if kind else []), "wardrobe"]


def test_a_model_is_fitted_into_its_size_with_its_front_ahead(catalogue: Catalogue) -> None:
    """Its pane, left out, counts for its size; x is turned round, or it would be mirrored."""
    red, front = sorted(read_parts(catalogue.models[0]), key=lambda part: part.uv is not None)
    corners = np.concatenate([red.corners, front.corners])
    np.testing.assert_allclose(corners.min((0, 1)), 0, atol=1e-12)
    np.testing.assert_allclose(corners.max((0, 1)), [1.0, 0.4, 2.0])
    np.testing.assert_allclose(front.corners[..., 1], 0.4)
    assert front.uv is not None and red.uv is None
    # the image's left, u = 0, is at the file's x = -1: to the right of who looks out of its front
    np.testing.assert_allclose(front.uv[..., 0], 1 - front.corners[..., 0])
    np.testing.assert_allclose(front.uv[..., 1], front.corners[..., 2] / 2)
    np.testing.assert_allclose(red.colour, [0.95, 0.03, 0.03])


def test_a_turned_model(tmp_path: Path) -> None:
    """By its matrix first: a file whose z is up."""
    z_up = SIDES.replace("v -1 4 0", "v -1 0 4")  # only so that the files differ
    entries = CABINET + "modelRotation#1=1 0 0 0 0 1 0 -1 0\n"
    (model,) = read_catalogue(write_furniture(tmp_path, entries, z_up)).models
    assert model.rotation == (1, 0, 0, 0, 0, 1, 0, -1, 0)
    corners = np.concatenate([part.corners for part in read_parts(model)])
    np.testing.assert_allclose(corners.max((0, 1)), [1.0, 0.5, 2.0])


def seen(catalogue: Catalogue, yaw: float, behind: bool = False) -> np.ndarray:
    """Linear colours [120, 160, 3] of the cabinet from 2.75 m before it, or behind it.

    The light is all around, or behind it at the camera. It stands turned by ``yaw`` about its back
    left corner at the origin, the camera with it.
    """
    rng = np.random.default_rng(0)
    (palette,), textures = make_materials(rng)
    piece = stand_in(Furniture(catalogue, textures, rng))
    kit = Kit(Surfaces(rng), palette, rng)
    with kit.s.at((0, 0, 0), yaw):
        piece.build(kit)
    eye = np.array([0.5, -2.75 if behind else 3.15, 1.0])
    ahead = np.array([0, 1.0 if behind else -1.0, 0])
    pose, down = np.eye(4), np.array([0, 0, -1.0])
    pose[:3, :3] = np.stack([np.cross(down, ahead), down, ahead], axis=1)
    pose[:3, 3] = eye
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    K = np.array([[60.0, 0, 79.5], [0, 60, 59.5], [0, 0, 1]])
    none = np.empty((0, 3))
    light = Lighting(none, none, np.ones(3), 1.0)
    if behind:
        light = Lighting(eye[None], 8 * np.ones((1, 3)), np.zeros(3), 1.0)
    image, depth = Renderer(kit.s.build(), textures, [light], K, (160, 120), 1).render(turn @ pose)
    np.testing.assert_allclose(depth[59, 80], 2.75, atol=1e-4)
    return image


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_its_image_is_upright_and_not_mirrored(catalogue: Catalogue, yaw: float) -> None:
    image = seen(catalogue, yaw)
    high, low, left, right = 45, 75, 73, 86
    green, blue = image[high, left], image[high, right]
    np.testing.assert_allclose(green, [0.03, 0.95, 0.03], atol=0.02)
    np.testing.assert_allclose(blue, [0.03, 0.03, 0.95], atol=0.02)
    dark = (127 / 255) ** 2.2
    np.testing.assert_allclose(image[low, left], [0.03, dark, 0.03], atol=0.02)
    np.testing.assert_allclose(image[low, right], [0.03, 0.03, dark], atol=0.02)


def test_faces_that_look_inwards_are_seen_too(tmp_path: Path) -> None:
    """Files disagree about which way round corners go: a back turned inside out is as bright."""
    inside_out = SIDES.replace("f 1 4 3 2", "f 1 2 3 4")
    one, other = (
        seen(read_catalogue(write_furniture(tmp_path / name, model=model)), 0.0, behind=True)
        for name, model in (("one", SIDES), ("other", inside_out))
    )
    assert one[59, 80, 0] > 0.3 > one[59, 80, 1]
    np.testing.assert_allclose(other[59, 80], one[59, 80], rtol=0.05)  # paint is not even


def test_chairs_of_a_table_are_mostly_alike(tmp_path: Path) -> None:
    chairs = "".join(
        f"name#{n}=Chair\ncategory#{n}=Office\nmodel#{n}=/made/cabinet/cabinet.obj\n"
        f"width#{n}=50\ndepth#{n}=50\nheight#{n}={80 + n}\n"
        for n in range(2, 12)
    )
    furniture = Furniture(
        read_catalogue(write_furniture(tmp_path, CABINET + chairs)),
        Textures([np.ones((SIZE, SIZE, 3))], [0.01]),
        np.random.default_rng(0),
    )
    heights = np.array([furniture.instead(ours("chair")).height for _ in range(2000)])
    models = heights[heights != 1.0]
    assert 0.55 < len(models) / len(heights) < 0.65
    same = (models[1:] == models[:-1]).mean()
    assert 0.7 < same < 0.76  # 0.7, and by chance


def test_a_model_that_cannot_be_read_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    furniture = Furniture(
        read_catalogue(write_furniture(tmp_path, model="v 0 0\nf 1 2 3\n")),
        Textures([np.ones((SIZE, SIZE, 3))], [0.01]),
        np.random.default_rng(0),
    )
    with caplog.at_level(logging.WARNING):
        pieces = [furniture.instead(ours("wardrobe")) for _ in range(20)]
    assert all(piece.height == 1.0 for piece in pieces)
    assert "made/cabinet/cabinet.obj left out" in caplog.text


def test_a_model_beside_the_list(tmp_path: Path) -> None:
    """Not in a folder of its own."""
    with zipfile.ZipFile(tmp_path / "test.sh3f", "w") as file:
        entries = CABINET.replace("/made/cabinet/", "")
        file.writestr("PluginFurnitureCatalog.properties", entries)
        for name, content in (("obj", SIDES), ("mtl", MATERIALS)):
            file.writestr(f"cabinet.{name}", content)
        file.writestr("front.png", front())
    parts = read_parts(read_catalogue(tmp_path).models[0])
    assert [part.image is not None for part in parts].count(True) == 1


def test_models_of_two_catalogues_have_images_of_their_own(tmp_path: Path) -> None:
    """Although their paths are the same."""
    write_furniture(tmp_path)
    shutil.copy(tmp_path / "test.sh3f", tmp_path / "two.sh3f")
    rng = np.random.default_rng(0)
    (palette,), textures = make_materials(rng)
    kit, furniture = (
        Kit(Surfaces(rng), palette, rng),
        Furniture(read_catalogue(tmp_path), textures, rng),
    )
    for _ in range(100):
        piece = furniture.instead(ours("wardrobe"))
        if piece.height != 1.0:
            piece.build(kit)
    geometry = kit.s.build()
    worn = np.unique(geometry.material[geometry.material != palette.index["painted"][0]])
    assert len(worn) == 2


def no_list(directory: Path) -> None:
    with zipfile.ZipFile(directory / "a.sh3f", "w") as file:
        file.writestr("readme", "")


def no_zip(directory: Path) -> None:
    (directory / "a.sh3f").write_text("furniture")


def nothing_of_use(directory: Path) -> None:
    write_furniture(directory, CABINET.replace("Bedroom", "Vehicles"))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda _: None, "no .sh3f file inside"),
        (no_zip, "a.sh3f: not a furniture catalogue"),
        (no_list, "a.sh3f: not a furniture catalogue"),
        (nothing_of_use, "no model in its catalogues"),
    ],
)
def test_folders_without_furniture(tmp_path: Path, make: Callable[[Path], None], says: str) -> None:
    make(tmp_path)
    with pytest.raises(TFLabError, match=says) as caught:
        read_catalogue(tmp_path)
    assert str(tmp_path) in str(caught.value)


def test_a_room_with_models(catalogue: Catalogue) -> None:
    """Its shell stays; wardrobes are the model, within its walls; twice the same frames."""
    settings = RoomSettings(48, 36, 3, 1)
    borrowed = Borrowed(catalogue)
    number = next(n for n in range(40) if make_room(n, borrowed).geometry.thin.any())
    room, bare = make_room(number, borrowed), make_room(number)
    assert not bare.geometry.thin.any()
    wardrobes = [p for p in room.placed if p.name == "wardrobe" and p.height == 2.0]
    assert wardrobes
    sides = np.linalg.norm(wardrobes[0].corners[1:3] - wardrobes[0].corners[0:2], axis=1)
    np.testing.assert_allclose(sides, [1.0, 0.5])
    points = room.geometry.vertices[room.geometry.faces[room.geometry.thin]].reshape(-1, 3)
    assert room.plan.inside(points).all()
    assert points[:, 2].min() > -1e-9 and points[:, 2].max() < 2.0 + 1e-9
    one, two = (list(generate_room(number, settings, borrowed)) for _ in range(2))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.image, b.image)
        np.testing.assert_array_equal(a.depth, b.depth)


def test_shards_are_trained_on_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Furniture is of scenes that are rendered: beside shards it changes nothing."""
    monkeypatch.setattr(RoomSource, "shards", lambda self: "the same")
    plain, given = (
        RoomSource(RoomsData(root=str(tmp_path), urls="DIR", furniture=furniture)).content()
        for furniture in (None, str(tmp_path / "absent"))
    )
    assert plain == given


def test_shards_of_such_scenes_name_the_makers(tmp_path: Path) -> None:
    directory = write_furniture(tmp_path / "furniture")
    result = call(
        "prepare",
        *("data=rooms", f"data.root={tmp_path}", f"data.furniture={directory}", "data.workers=1"),
        *("data.size=1", "data.val_size=0", "data.test_size=0", "data.frames=24"),
        *(
            "data.width=32",
            "data.height=24",
            f"shards={tmp_path / 'shards'}",
            "shard_chunks=2",
            "shard_size=2",
        ),
    )
    assert result.status == 0, result.err
    assert "Oak wardrobe" in (tmp_path / "shards" / ATTRIBUTION).read_text(encoding="utf-8")
