"""A capture at another image size: the one that a network was trained at."""

from __future__ import annotations

import numpy as np
import torch
from PIL import Image

from tf_lab.data.capture import Altered, Capture
from tf_lab.geometry import scale_intrinsics


class Resized(Altered):
    """A `Capture` whose colour images are resized to (width, height).

    The aspect ratio need not be kept: the intrinsics follow. Depth is resized by nearest
    neighbours, so that no two readings are mixed.
    """

    def __init__(self, capture: Capture, size: tuple[int, int]) -> None:
        super().__init__(capture)
        self.size = size
        self.K = scale_intrinsics(torch.from_numpy(capture.K), capture.size, size).numpy()

    def image(self, index: int) -> np.ndarray:
        """uint8 [H, W, 3] RGB, area-averaged."""
        image = super().image(index)
        if (image.shape[1], image.shape[0]) == self.size:
            return image
        return np.asarray(Image.fromarray(image).resize(self.size, Image.Resampling.BOX))

    def depth(self, index: int) -> np.ndarray | None:
        """float32 [H, W] metres, 0 where unknown; None without depth."""
        depth = super().depth(index)
        if depth is None:
            return None
        return np.array(Image.fromarray(depth).resize(self.size, Image.Resampling.NEAREST))
