"""Fast JPEG decoding against Pillow's."""

import contextlib
import io

import numpy as np
import pytest
from PIL import Image

from tf_lab.data.jpeg import decode_jpeg, jpeg_size

SIZE = (37, 22)


def jpeg(size: tuple[int, int] = SIZE, seed: int = 0, **options: object) -> bytes:
    coarse = np.random.default_rng(seed).integers(0, 256, (5, 6, 3), np.uint8)
    file = io.BytesIO()
    Image.fromarray(coarse).resize(size).save(file, "JPEG", **options)
    return file.getvalue()


def decoded(*files: bytes) -> np.ndarray:
    images = np.zeros((len(files), 3, SIZE[1], SIZE[0]), np.uint8)
    for data, image in zip(files, images, strict=True):
        decode_jpeg(data, image)
    return images


@pytest.mark.parametrize(
    "options",
    [{"quality": 95}, {"quality": 40}, {"progressive": True}, {"subsampling": 0}, {"exif": True}],
)
def test_pixels_are_those_of_pillow(options: dict[str, object]) -> None:
    if "exif" in options:  # a turned picture: pixels as stored, as the cameras know them
        exif = Image.Exif()
        exif[0x0112] = 6
        options = {"exif": exif}
    files = [jpeg(seed=i, **options) for i in range(3)]
    expected = [np.asarray(Image.open(io.BytesIO(file))).transpose(2, 0, 1) for file in files]
    found = decoded(*files)
    # decoders may round differently
    assert np.abs(found.astype(int) - np.array(expected, int)).max() <= 1
    assert jpeg_size(files[0]) == SIZE


@pytest.mark.parametrize("length", [0, 1, 2, 3, 30, 150, 300, -1])
def test_a_cut_file(length: int) -> None:
    with pytest.raises(ValueError, match="JPEG"):
        decoded(jpeg(), jpeg()[:length])


def test_another_size() -> None:
    with pytest.raises(ValueError, match="it is 38x22, not 37x22"):
        decoded(jpeg((38, 22)))


def test_damage_never_ends_in_another_error() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        data = bytearray(jpeg())
        for at in rng.integers(0, len(data), rng.integers(1, 20)):
            data[at] = rng.integers(256)
        with contextlib.suppress(ValueError):
            decoded(bytes(data))
