"""What the batches of all trainings share: how they get to the device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor


@dataclass
class Batch:
    """A dataclass of tensors, and of what stays where it is."""

    def to(self, device: torch.device, non_blocking: bool = True) -> Self:
        """The batch on another device (Lightning calls this); from pinned memory none waits."""
        return self._each(
            lambda x: x.to(device, non_blocking=non_blocking and device.type != "cpu")
        )

    def pin_memory(self) -> Self:
        """The batch where a GPU can fetch it by itself (a loader calls this)."""
        return self._each(lambda x: x.pin_memory())

    def _each(self, change: Callable[[Tensor], Tensor]) -> Self:
        tensors = {name: x for name, x in vars(self).items() if isinstance(x, Tensor)}
        return replace(self, **{name: change(x) for name, x in tensors.items()})
