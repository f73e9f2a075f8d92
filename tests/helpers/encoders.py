"""Encoders small enough for tests."""

from pathlib import Path
from typing import Any

MAPS: dict[str, Any] = {
    "coarse_stride": 8,
    "fine_stride": 2,
    "coarse_channels": 6,
    "fine_channels": 4,
    "unit_norm": True,
    "pyramid_channels": 8,
}
NOWHERE = Path("no such file")  # for weights that no test reads
