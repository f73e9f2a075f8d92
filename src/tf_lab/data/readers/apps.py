"""What the apps that record ARKit on iPhone and iPad have in common: its cameras and its depth.

ARKit's world is metric and its y axis points up. Its camera has x along the long side of the phone,
which is the right of the images as the sensor has them, y up and z back. Apple measures the
principal point from the corner of the image: pixel centres lie at 0.5. Depth is registered to the
colour image, at a lower resolution, and comes with a map of how far to trust it: low, medium or
high. Low is what ARKit guesses at edges and on shiny surfaces: it is left out, medium stays (as in
Apple's own sample and the apps' tools).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tf_lab.data.capture import open_image
from tf_lab.data.lens import Camera
from tf_lab.data.readers.images import is_central, is_file
from tf_lab.data.readers.source import DepthFile, Pixels
from tf_lab.errors import TFLabError

DOWN = (0.0, -1.0, 0.0)
MEDIUM = 1  # ARConfidenceLevel: 0 low, 1 medium, 2 high


def arkit_camera(size: tuple[int, int], fx: float, fy: float, cx: float, cy: float) -> Camera:
    """The camera of images of (width, height) ``size`` by Apple's numbers, pixels.

    Raises:
        ValueError: they belong to images of another size or orientation.
        TFLabError: they are not those of a camera.
    """
    camera = Camera(size, fx, fy, cx - 0.5, cy - 0.5)
    if not is_central((camera.cx, camera.cy), size):
        raise ValueError(
            f"({cx:g}, {cy:g}) is not near the middle of {size[0]}x{size[1]} images; give them in "
            "the size and orientation they were taken in"
        )
    return camera


def confident_depth(depth: Path, confidence: Path) -> Pixels | None:
    """A depth map in millimetres, where ARKit is sure enough of it; None: there is no such file.

    Args:
        depth: its file.
        confidence: of the map of confidence; all is kept without it.
    """
    if not is_file(depth):
        return None
    return ConfidentDepth(depth, confidence) if is_file(confidence) else DepthFile(depth)


@dataclass(frozen=True)
class ConfidentDepth:
    """float32 [H, W] metres of a depth map; 0 where the confidence is too low.

    Attributes:
        depth: its file.
        confidence: the 8-bit image of the same size.
        scale: units of depth a metre; None: millimetres.
    """

    depth: Path
    confidence: Path
    scale: float | None = None

    def __call__(self) -> np.ndarray:
        """Read it."""
        depth = DepthFile(self.depth, self.scale)()
        try:
            with open_image(self.confidence) as image:
                confidence = np.asarray(image)
        except Exception as error:  # damaged data makes Pillow raise nearly anything
            raise TFLabError(f"{self.confidence}: cannot be read as an image ({error})") from error
        if confidence.shape != depth.shape:
            raise TFLabError(f"{self.confidence}: is of another size than {self.depth}")
        return np.where(confidence >= MEDIUM, depth, 0).astype(np.float32)

    def __str__(self) -> str:
        return str(self.depth)
