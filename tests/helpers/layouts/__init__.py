"""One synthetic room, written as each source would have it: independent of the readers' code.

Every module here has ``write(directory, frames) -> Path`` (what to open) and ``OPTIONS``, what the
user of that source has to add to `open_capture`.
"""

from functools import lru_cache
from types import ModuleType

from helpers.layouts import (
    arkit,
    colmap_binary,
    colmap_text,
    plain,
    polycam,
    record3d,
    replica,
    scanner_app,
    scannet,
    sens,
    sensreader,
    seven_scenes,
    stray_scanner,
    transforms,
    transforms_ngp,
    transforms_splits,
    tum,
    tum_associations,
    video,
)
from tf_lab.data.rooms import RoomSettings, generate_room
from tf_lab.data.scene import Frame

MODULES = (
    plain, seven_scenes, scannet, sens, sensreader, tum, tum_associations, transforms,
    transforms_ngp, transforms_splits, colmap_text, colmap_binary, arkit, stray_scanner,
    scanner_app, polycam, record3d, replica, video,
)  # fmt: skip
LAYOUTS: dict[str, ModuleType] = {module.__name__.split(".")[-1]: module for module in MODULES}


@lru_cache(maxsize=1)
def room_frames() -> tuple[Frame, ...]:
    """A room of the embedded set as 24 frames with depth; depth in whole millimetres."""
    return tuple(generate_room(7, RoomSettings(width=96, height=72, frames=24)))
