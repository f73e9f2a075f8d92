"""How a source is read: its layout, scale and gravity, and mends for what it says wrongly."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, fields
from typing import Any

from tf_lab.errors import TFLabError
from tf_lab.support.settings import plain_values, setting

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

    Raises:
        TFLabError: a value that cannot be; the message has the choices.
    """

    format: str | None = setting(None, "name the layout, see docs/data.md; null: it is detected")
    gravity: tuple[float, float, float] | None = setting(
        None,
        'direction of "down" in the source\'s world, as [0,0,-1]; null: stated by the layout, or '
        "estimated",
    )
    scale: float | None = setting(
        None, "metres per unit of the poses; null: as the layout says (COLMAP says nothing)"
    )
    poses: str | None = setting(
        None, "camera_to_world or world_to_camera: what the files hold; null: as the layout has it"
    )
    axes: str | None = setting(
        None,
        "of the camera: opencv, opengl, unity, ... or where x, y, z point, as in rdf; null: the "
        "layout's",
    )
    rotations: str = setting("as_given", "or transposed: rotations written column by column")
    quaternions: str | None = setting(None, "wxyz or xyzw; null: as the layout has them")
    focal_scale: float = setting(1.0, "factor on the focal lengths")
    principal: Any = setting(
        None, "center (of the images), or [x,y] in pixels, added to the principal point"
    )
    intrinsics_size: tuple[int, int] | None = setting(
        None, "[width,height] of the images that the intrinsics are of, if others"
    )
    depth_camera: str = setting(
        "shared",
        "as_given: depth without a camera of its own keeps the intrinsics as they are stated",
    )
    turn: int = setting(0, "90, 180 or 270: turn the images clockwise to be as the poses have them")
    shift: int = setting(0, "an image takes the pose of the frame this many later")
    depth_scale: float | None = setting(
        None, "units per metre of the depth maps; null: as the layout says"
    )

    def __post_init__(self) -> None:
        plain_values(self)
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
        if not (self.principal in (None, CENTER) or _two_numbers(self.principal)):
            raise TFLabError(f"principal={self.principal}: choose {CENTER}, or [x,y] in pixels")
        size = self.intrinsics_size
        if size is not None and not (_two_numbers(size) and min(size) >= 1):
            raise TFLabError(f"intrinsics_size={size}: [width,height] in pixels")

    @classmethod
    def part_of(cls, settings: Any) -> ReadSettings:
        """How a source is read, out of settings that say other things as well."""
        return cls(**{field.name: getattr(settings, field.name) for field in fields(cls)})


def _one_of(name: str, value: Any, choices: tuple[Any, ...]) -> None:
    if value not in choices:
        named = " or ".join(str(choice) for choice in choices if choice is not None)
        raise TFLabError(f"{name}={value}: choose {named}")


def _positive(name: str, value: float | None, meaning: str) -> None:
    if value is None:
        return
    if not isinstance(value, (int, float)) or not (math.isfinite(value) and value > 0):
        raise TFLabError(f"{name}={value}: {meaning}, a positive number")


def _two_numbers(values: Any) -> bool:
    numeric = isinstance(values, tuple) and all(isinstance(v, (int, float)) for v in values)
    return numeric and len(values) == 2 and all(math.isfinite(v) for v in values)


AS_STATED = ReadSettings()
