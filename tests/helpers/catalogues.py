"""Catalogues of Sweet Home 3D as it writes them: one of furniture, one of textures."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

from tf_lab.data.rooms.photographs import LISTS

# A cabinet in a file's frame (y up, front towards z): 2 wide, 4 high, 1 deep; its front carries an
# image, its other sides are red; a pane before it.
SIDES = """
mtllib cabinet.mtl
v -1 0 0
v 1 0 0
v 1 4 0
v -1 4 0
v -1 0 1
v 1 0 1
v 1 4 1
v -1 4 1
v -1 0 1.25
v 1 0 1.25
v 1 4 1.25
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl red
f 1 4 3 2
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
usemtl front
f 5/1 6/2 7/3 8/4
"""
PANE = "usemtl glass\nf 9 10 11\n"
MATERIALS = """
newmtl red
Kd 1 0 0
newmtl front
Kd 1 1 1
map_Kd front.png
newmtl glass
Kd 1 1 1
d 0.1
"""
CABINET = """
id=Test#Catalogue
license=Made up \\u00e9
name#1=Oak wardrobe
category#1=Bedroom
model#1=/made/cabinet/cabinet.obj
width#1=100
depth#1=50
height#1=200
doorOrWindow#1=false
creator#1=Somebody
"""


def front() -> bytes:
    """Bright on top, dark below; green on its left half, blue on its right."""
    image = np.zeros((64, 64, 3), np.uint8)
    image[:, :32, 1] = image[:, 32:, 2] = 255
    image[32:] //= 2
    content = io.BytesIO()
    Image.fromarray(image).save(content, "png")
    return content.getvalue()


def write_furniture(directory: Path, entries: str = CABINET, model: str = SIDES + PANE) -> Path:
    directory.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(directory / "test.sh3f", "w") as file:
        file.writestr("PluginFurnitureCatalog.properties", entries)
        file.writestr("made/cabinet/cabinet.obj", model)
        file.writestr("made/cabinet/cabinet.mtl", MATERIALS)
        file.writestr("made/cabinet/front.png", front())
    return directory


BOARDS = """
id=Test#Textures
license=Made up \\u00e9
name#1=Oak boards
category#1=Floor
image#1=/made/boards.png
width#1=80
height#1=40
creator#1=Somebody
"""


def halves(size: tuple[int, int] = (64, 32)) -> bytes:
    """Red on its left half, blue on its right."""
    image = np.zeros((size[1], size[0], 3), np.uint8)
    image[:, : size[0] // 2, 0] = image[:, size[0] // 2 :, 2] = 255
    content = io.BytesIO()
    Image.fromarray(image).save(content, "png")
    return content.getvalue()


def write_textures(
    directory: Path,
    entries: str = BOARDS,
    name: str = "test.sh3t",
    inside: str = LISTS[0],
    image: bytes | None = None,
) -> Path:
    directory.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(directory / name, "w") as file:
        file.writestr(inside, entries)
        file.writestr("made/boards.png", halves() if image is None else image)
    return directory
