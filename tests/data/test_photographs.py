"""Photographs of surfaces: read from catalogues, of the stated size, on some surfaces, named."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers.catalogues import BOARDS, write_textures
from tf_lab.data.rooms import RoomSettings, generate_room, make_room
from tf_lab.data.rooms.borrowed import Borrowed
from tf_lab.data.rooms.materials import Textures, make_materials
from tf_lab.data.rooms.photographs import (
    LISTS,
    SHARE,
    Photographs,
    read_photographs,
    read_texture,
)
from tf_lab.data.rooms.textures import SIZE
from tf_lab.errors import TFLabError


@pytest.fixture
def photographs(tmp_path: Path) -> Photographs:
    return read_photographs(write_textures(tmp_path / "textures"))


def test_what_a_catalogue_says(photographs: Photographs) -> None:
    (image,) = photographs.images
    assert (image.name, image.maker) == ("Oak boards", "Somebody")
    assert image.roles == ("floor", "wood")
    assert image.size == (0.8, 0.4)
    text = photographs.attribution()
    assert "test.sh3t: Made up é" in text
    assert "- Oak boards (made/boards.png), by Somebody" in text


@pytest.mark.parametrize(
    ("said", "roles"),
    [
        ("name#1=Red tiles", ("floor",)),
        ("name#1=Tiles\ncategory#1=Wall", ("accent", "wall")),
        ("name#1=Small bricks\ncategory#1=Bricks", ("accent", "wall")),
        ("name#1=Panel\ncategory#1=Wood", ("floor", "wood")),
        ("name#1=Boards of wood\ncategory#1=Wall", ("accent", "wall", "wood")),
        ("name#1=Blue\ncategory#1=Fabric", ("fabric",)),
        ("name#1=Carpet\ncategory#1=Miscellaneous", ("fabric", "floor", "rug")),
        ("name#1=Stone\ncategory#1=Floor", ("floor",)),
        ("name#1=Cloudy\ncategory#1=Sky", None),
        ("name#1=Grass", None),
        ("name#1=Lines\ncategory#1=Miscellaneous", None),
        ("width#1=wide", None),
        ("width#1=2", None),
        ("image#1=/made/absent.png", None),
    ],
)
def test_what_covers_what(tmp_path: Path, said: str, roles: tuple[str, ...] | None) -> None:
    """A line that comes later counts; a second entry is as it was, so that there is one."""
    second = BOARDS.replace("#1=", "#2=")
    images = read_photographs(write_textures(tmp_path, BOARDS + said + second)).images
    assert [image.roles for image in images] == [*([roles] if roles else []), ("floor", "wood")]


def test_an_image_has_its_size(photographs: Photographs) -> None:
    """80 by 40 cm: twice one above the other, so that the square is 80 cm wide."""
    texture = read_texture(photographs.images[0])
    assert texture is not None
    image, texel = texture
    assert image.shape == (SIZE, SIZE, 3)
    assert texel == pytest.approx(0.8 / SIZE)
    for half, colour in (
        (image[:, :248], [0.95, 0.03, 0.03]),
        (image[:, 264:], [0.03, 0.03, 0.95]),
    ):
        np.testing.assert_allclose(half, np.broadcast_to(colour, half.shape), atol=1e-3)


def test_an_image_that_is_higher_than_wide(tmp_path: Path) -> None:
    entries = BOARDS.replace("width#1=80", "width#1=20").replace("height#1=40", "height#1=30")
    texture = read_texture(read_photographs(write_textures(tmp_path, entries)).images[0])
    assert texture is not None
    image, texel = texture
    assert texel == pytest.approx(0.6 / SIZE)  # three of them beside each other, two above
    red = image[SIZE // 2, :, 0] > 0.5
    assert np.count_nonzero(np.diff(red.astype(int)) == -1) == 3


def test_some_materials_are_covered_the_others_stay(photographs: Photographs) -> None:
    (palette,), painted = make_materials(np.random.default_rng(7))
    may_be = [*palette.index["floor"], *palette.index["wood"]]
    covered = []
    for seed in range(200):
        textures = Textures(painted._images, [0.01] * len(painted._images))
        photographs.cover([palette], textures, seed)
        both = zip(painted._images, textures._images, strict=True)
        changed = [not np.array_equal(a[:9, :9], b[:9, :9]) for a, b in both]
        assert not any(c for n, c in enumerate(changed) if n not in may_be)
        covered.append([changed[n] for n in may_be])
    np.testing.assert_allclose(np.mean(covered, axis=0), SHARE["floor"], atol=0.1)


def test_a_room_with_photographs(photographs: Photographs) -> None:
    """Its geometry and its walk stay, its depth with them; twice the same frames."""
    settings, borrowed = RoomSettings(48, 36, 4, 1), Borrowed(photographs=photographs)
    one, two = (list(generate_room(1, settings, borrowed)) for _ in range(2))
    plain = list(generate_room(1, settings))
    for a, b, bare in zip(one, two, plain, strict=True):
        np.testing.assert_array_equal(a.image, b.image)
        np.testing.assert_array_equal(a.depth, bare.depth)
        np.testing.assert_array_equal(a.world_T_cam, bare.world_T_cam)
    assert any((a.image != bare.image).any() for a, bare in zip(one, plain, strict=True))
    assert len(make_room(1, borrowed).geometry.faces) == len(make_room(1).geometry.faces)


def test_an_image_that_cannot_be_read_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    borrowed = Borrowed(photographs=read_photographs(write_textures(tmp_path, image=b"no picture")))
    settings = RoomSettings(48, 36, 2, 1)
    with caplog.at_level(logging.WARNING):
        frames = [f for seed in range(3) for f in generate_room(seed, settings, borrowed)]
    plain = [f for seed in range(3) for f in generate_room(seed, settings)]
    assert all((a.image == b.image).all() for a, b in zip(frames, plain, strict=True))
    assert "made/boards.png left out" in caplog.text


def test_the_programs_own_catalogue_and_a_file_by_itself(tmp_path: Path) -> None:
    write_textures(tmp_path, name="sweethome3d.jar", inside=LISTS[1])
    digests = {read_photographs(place).digest for place in (tmp_path, tmp_path / "sweethome3d.jar")}
    assert len(digests) == 1


def no_list(directory: Path) -> None:
    write_textures(directory, inside="readme")


def no_zip(directory: Path) -> None:
    (directory / "a.sh3t").write_text("textures")


def nothing_of_use(directory: Path) -> None:
    write_textures(directory, BOARDS.replace("Oak boards", "Grass"))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda _: None, "no .sh3t file and no sweethome3d.jar"),
        (no_zip, "a.sh3t: not a catalogue of textures"),
        (no_list, "test.sh3t: not a catalogue of textures"),
        (nothing_of_use, "no image in its catalogues"),
    ],
)
def test_folders_without_textures(tmp_path: Path, make: Callable[[Path], None], says: str) -> None:
    make(tmp_path)
    with pytest.raises(TFLabError, match=says) as caught:
        read_photographs(tmp_path)
    assert str(tmp_path) in str(caught.value)
    with pytest.raises(TFLabError, match=r"no \.sh3t file"):
        read_photographs(tmp_path / "nowhere")
