"""How a source is read: its layout, scale and gravity, and mends for what it says wrongly."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from tf_lab.errors import TFLabError

POSES = ("camera_to_world", "world_to_camera")
QUATERNIONS = ("wxyz", "xyzw")
ROTATIONS = ("as_given", "transposed")
DEPTH_CAMERAS = ("shared", "as_given")
TURNS = (0, 90, 180, 270)
# Where x, y and z of a camera point: right or left, up or down, forward or back.
AXES = {
    "opencv": "rdf",
    "opengl": "rub",
    "unity": "ruf",
    "unreal": "fru",
    "ros": "flu",
    "pytorch3d": "luf",
    "llff": "drb",
}
CODES = frozenset(
    "".join(code)
    for sides in itertools.product("rl", "ud", "fb")
    for code in itertools.permutations(sides)
)
CENTER = "center"


@dataclass(frozen=True)
class Convention:
    """How a layout writes poses.

    Attributes:
        poses: one of `POSES`: which transform the file holds.
        axes: the camera's axes, a name of `AXES` or a code of `CODES`.
        quaternions: their order, one of `QUATERNIONS`; None: it writes matrices.
    """

    poses: str = "camera_to_world"
    axes: str = "opencv"
    quaternions: str | None = None


OURS = Convention()


@dataclass(frozen=True)
class ReadSettings:
    """How a source is read. The defaults take it at its word; the mends say what is so instead.

    Attributes:
        format: the layout's name; None recognises it.
        gravity: the direction of gravity (down) in the source's world, for a source that does not
            state it (see `tf_lab.data.gravity`); without it, it is estimated.
        scale: metres per unit of the poses; None: as the layout says (COLMAP says nothing).
        poses: the transform that the files hold, of `POSES`; None: the layout's.
        axes: where the camera's x, y, z point: a name of `AXES` or three letters of right, left,
            up, down, forward, back ("rdf"); None: the layout's. Of left-handed ones the world is
            left-handed, too.
        rotations: of `ROTATIONS`: the 3x3 rotations may be written column by column.
        quaternions: the order of their four numbers, of `QUATERNIONS`; None: the layout's.
        focal_scale: factor on the focal lengths.
        principal: pixels (x, y) to add to the principal point, or "center": the images' middle.
        intrinsics_size: (width, height) of the images that the intrinsics are of, where these were
            resized afterwards.
        depth_camera: of `DEPTH_CAMERAS`: whether the mends of the intrinsics also hold for depth
            that has no camera of its own ("shared"), or that keeps them as given.
        turn: degrees clockwise by which images and depth have to be turned to be those of the
            poses. Intrinsics are of the images before or after, whichever they fit.
        shift: an image takes the pose of the frame this many later.
        depth_scale: units per metre of the depth maps; None: as the layout says.

    Raises:
        TFLabError: a value that cannot be; the message has the choices.
    """

    format: str | None = None
    gravity: tuple[float, float, float] | None = None
    scale: float | None = None
    poses: str | None = None
    axes: str | None = None
    rotations: str = "as_given"
    quaternions: str | None = None
    focal_scale: float = 1.0
    principal: tuple[float, float] | str | None = None
    intrinsics_size: tuple[int, int] | None = None
    depth_camera: str = "shared"
    turn: int = 0
    shift: int = 0
    depth_scale: float | None = None

    def __post_init__(self) -> None:
        if self.axes is not None and self.axes not in AXES and self.axes not in CODES:
            raise TFLabError(
                f"axes={self.axes}: choose {', '.join(AXES)}, or say where x, y and z point, as in "
                "rdf: right, down, forward (or left, up, back)"
            )
        _one_of("poses", self.poses, (None, *POSES))
        _one_of("rotations", self.rotations, ROTATIONS)
        _one_of("quaternions", self.quaternions, (None, *QUATERNIONS))
        _one_of("depth_camera", self.depth_camera, DEPTH_CAMERAS)
        _one_of("turn", self.turn, TURNS)
        _positive("scale", self.scale, "metres per unit of the poses")
        if self.focal_scale is None:
            raise TFLabError("focal_scale=None: 1 leaves the focal lengths as they are")
        _positive("focal_scale", self.focal_scale, "a factor on the focal lengths")
        _positive("depth_scale", self.depth_scale, "units per metre of the depth maps")
        if not isinstance(self.shift, int):
            raise TFLabError(f"shift={self.shift}: a whole number of frames")
        if not (self.principal in (None, CENTER) or _numbers(self.principal, 2)):
            raise TFLabError(f"principal={self.principal}: choose {CENTER}, or [x,y] in pixels")
        size = self.intrinsics_size
        if size is not None and not (_numbers(size, 2) and min(size) >= 1):
            raise TFLabError(f"intrinsics_size={size}: [width,height] in pixels")

    @classmethod
    def of(cls, config: Mapping[str, Any]) -> ReadSettings:
        """The settings of these names in a config, which may have others and lack some."""
        given: dict[str, Any] = {f.name: config[f.name] for f in fields(cls) if f.name in config}
        for name, value in given.items():
            given[name] = tuple(value) if isinstance(value, list) else value
        return cls(**given)


def _one_of(name: str, value: Any, choices: tuple[Any, ...]) -> None:
    if value not in choices:
        named = " or ".join(str(choice) for choice in choices if choice is not None)
        raise TFLabError(f"{name}={value}: choose {named}")


def _positive(name: str, value: float | None, meaning: str) -> None:
    if value is None:
        return
    if not isinstance(value, (int, float)) or not (math.isfinite(value) and value > 0):
        raise TFLabError(f"{name}={value}: {meaning}, a positive number")


def _numbers(values: Any, count: int) -> bool:
    numeric = isinstance(values, tuple) and all(isinstance(v, (int, float)) for v in values)
    return numeric and len(values) == count and all(math.isfinite(v) for v in values)


AS_STATED = ReadSettings()
