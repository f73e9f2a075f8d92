"""JPEG files to pixels, the fast way: most of what making a training batch costs."""

from __future__ import annotations

import cv2
import numpy as np

_END = b"\xff\xd9"
# start-of-frame markers of baseline and progressive JPEG: what Pillow writes
_FRAMES = (0xC0, 0xC1, 0xC2)


def jpeg_size(data: bytes) -> tuple[int, int]:
    """The (width, height) that a JPEG file declares.

    Raises:
        ValueError: it is not one.
    """
    at = 2
    while data[:2] == b"\xff\xd8" and at + 9 <= len(data) and data[at] == 0xFF:
        if data[at + 1] in _FRAMES:
            height, width = data[at + 5 : at + 7], data[at + 7 : at + 9]
            return int.from_bytes(width, "big"), int.from_bytes(height, "big")
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    raise ValueError("not a JPEG file")


def decode_jpeg(data: bytes, image: np.ndarray) -> None:
    """Decode a JPEG file into ``image``, uint8 [3, H, W] RGB.

    Raises:
        ValueError: it is damaged, cut off or of another size; told before much is allocated.
    """
    height, width = image.shape[1:]
    found = jpeg_size(data)
    if found != (width, height):
        raise ValueError(f"it is {found[0]}x{found[1]}, not {width}x{height}")
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data.endswith(_END) else None
    if bgr is None or bgr.shape != (height, width, 3):
        raise ValueError("not a whole JPEG file")
    red, green, blue = image
    cv2.split(bgr, [blue, green, red])
