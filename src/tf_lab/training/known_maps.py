"""Feature maps of images that come again and again to an encoder that no longer changes."""

from __future__ import annotations

import time

import torch
from torch import Tensor

from tf_lab.network.network import LEVELS, Network


class KnownMaps:
    """Encodes an image once: two thirds of a training step on a CPU is the encoder's.

    Images are known by their content. Results do not depend on what is kept, so that a resumed
    training goes on as if never stopped: maps are kept in half precision and used so from the
    first time, and each image is encoded by itself, as rounding depends on the batch. Images on a
    GPU are encoded every time: that is faster than fetching maps from the host.

    Args:
        network: whose encoder is frozen here.
        budget: bytes of maps to keep; images beyond it are encoded every time.

    Attributes:
        asked, encoded: how many images so far.
        seconds: that encoding them took.
    """

    def __init__(self, network: Network, budget: int) -> None:
        network.encoder.requires_grad_(False)
        self.network, self.budget = network, budget
        self.nbytes = 0
        self.asked, self.encoded, self.seconds = 0, 0, 0.0
        self._known: dict[int, dict[str, Tensor]] = {}

    @torch.no_grad()
    def __call__(self, images: Tensor) -> dict[str, Tensor]:
        """Maps {"coarse", "fine"} [N, C, h, w] of uint8 images [N, 3, H, W], on their device."""
        self.network.encoder.eval()  # batch statistics, too, stay what they are
        if not images.is_cpu:
            return self.network.encode(images)
        keys = [hash(image.numpy().tobytes()) for image in images]
        new = [i for i, key in enumerate(keys) if key not in self._known]
        found = {key: self._known[key] for key in keys if key in self._known}
        start = time.monotonic()
        for i in new:
            maps = self.network.encode(images[i : i + 1])
            found[keys[i]] = {level: maps[level][0].half() for level in LEVELS}
            self._keep(keys[i], found[keys[i]])
        self.seconds += time.monotonic() - start
        self.asked, self.encoded = self.asked + len(keys), self.encoded + len(new)
        return {level: torch.stack([found[key][level].float() for key in keys]) for level in LEVELS}

    def _keep(self, key: int, maps: dict[str, Tensor]) -> None:
        size = sum(m.nbytes for m in maps.values())
        if key not in self._known and self.nbytes + size <= self.budget:
            self._known[key] = maps
            self.nbytes += size
