from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from helpers.online.scenes import FAR
from tf_lab.data.scene import Scene


@pytest.fixture(scope="session")
def tiny_network(tiny_network: Callable[..., Any]) -> Callable[..., Any]:
    """Networks that see less far, so that the scenes are small."""
    return lambda **changes: tiny_network(**{"far": FAR, **changes})


@pytest.fixture(scope="session")
def scene(box_scene: Path) -> Scene:
    return Scene(box_scene)
