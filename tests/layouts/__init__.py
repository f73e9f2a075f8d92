"""One synthetic room, written as each source would have it: independent of the readers' code.

Every module here has ``write(directory, frames) -> Path`` (what to open) and ``OPTIONS``, what the
user of that source has to add to `open_capture`.
"""

from functools import lru_cache
from types import ModuleType

from layouts import (
    arkit,
    colmap_binary,
    colmap_text,
    plain,
    scannet,
    sens,
    seven_scenes,
    transforms,
    tum,
    video,
)
from tf_lab.data.rooms import RoomSettings, generate_room
from tf_lab.data.scene import Frame

MODULES = (
    plain, seven_scenes, scannet, sens, tum, transforms, colmap_text, colmap_binary, arkit, video,
)  # fmt: skip
LAYOUTS: dict[str, ModuleType] = {module.__name__.split(".")[-1]: module for module in MODULES}


@lru_cache(maxsize=1)
def room_frames() -> tuple[Frame, ...]:
    """A room of the embedded set as 24 frames with depth; depth in whole millimetres."""
    return tuple(generate_room(7, RoomSettings(width=96, height=72, frames=24)))
