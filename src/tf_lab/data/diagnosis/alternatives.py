"""Other ways to read a capture, one thing changed at a time: what people get wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tf_lab.data.readers.source import Given
from tf_lab.data.reading import AXES, CODES, POSES, QUATERNIONS, ReadSettings

SHIFTS = 5  # frames, either way
SCANNET = (1296, 968)  # pixels of its colour images, which many exports make smaller


@dataclass(frozen=True)
class Alternative:
    """One other way to read the capture.

    Attributes:
        text: what is supposed, for the table.
        setting: that says so, "NAME=VALUE".
        settings: with it.
    """

    text: str
    setting: str
    settings: ReadSettings


def of_poses(settings: ReadSettings, given: Given) -> Iterator[Alternative]:
    """Other meanings of the numbers of the poses, the usual ones first."""
    poses = settings.poses or given.convention.poses
    other = next(name for name in POSES if name != poses)
    yield _changed(settings, f"poses are {other.replace('_', ' ')}", poses=other)
    axes = settings.axes or given.convention.axes
    used = AXES.get(axes, axes)
    names = {code: name for name, code in AXES.items()}
    for code in sorted(CODES, key=lambda code: (code not in names, code)):
        if code != used and code not in _rolled(used):
            name = names.get(code, code)
            yield _changed(settings, f"camera axes are {name}", axes=name)
    way = "as_given" if settings.rotations == "transposed" else "transposed"
    yield _changed(settings, f"rotations are {way.replace('_', ' ')}", rotations=way)
    order = settings.quaternions or given.convention.quaternions
    if order is not None:
        swapped = next(name for name in QUATERNIONS if name != order)
        yield _changed(settings, f"quaternions are {swapped}", quaternions=swapped)


def of_images(settings: ReadSettings, given: Given) -> Iterator[Alternative]:
    """Other images to the same poses: turned, or of other moments."""
    for turn in (90, 180, 270):
        value = (settings.turn + turn) % 360
        yield _changed(settings, f"images turned by {value} degrees", turn=value)
    for step in range(1, SHIFTS + 1):
        for shift in (settings.shift + step, settings.shift - step):
            yield _changed(settings, f"poses of {shift:+d} frames", shift=shift)


def of_intrinsics(settings: ReadSettings, given: Given) -> Iterator[Alternative]:
    """Intrinsics of other images, and those whose principal point is the middle."""
    camera = given.frames[0].camera
    width, height = camera.size
    ratios = np.array([(2 * camera.cx + 1) / width, (2 * camera.cy + 1) / height])
    if settings.intrinsics_size is None:
        factors = sorted({round(float(ratios.mean()) * 4) / 4, 2.0, 0.5, 4.0, 1.5})
        sizes = [(round(width * ratio), round(height * ratio)) for ratio in factors if ratio > 0]
        for size in dict.fromkeys([*sizes, SCANNET]):
            off = ratios * camera.size / size - 1
            if size != tuple(camera.size) and np.abs(off).max() < 0.15:
                text = f"intrinsics of {size[0]}x{size[1]} images"
                yield _changed(settings, text, intrinsics_size=size)
    if settings.principal is None and np.abs(ratios - 1).max() > 0.03:
        yield _changed(settings, "principal point in the middle", principal="center")


def focal(settings: ReadSettings, factor: float) -> Alternative:
    """Focal lengths ``factor`` times as long as with the settings."""
    value = float(f"{settings.focal_scale * factor:.3g}")
    return _changed(settings, f"focal length x {value:g}", focal_scale=value)


def moved_centre(settings: ReadSettings, x: float, y: float) -> Alternative:
    """A principal point so many pixels off."""
    before = settings.principal if isinstance(settings.principal, tuple) else (0.0, 0.0)
    value = (round(before[0] + x, 1), round(before[1] + y, 1))
    return _changed(
        settings, f"principal point moved by {value[0]:g}, {value[1]:g}", principal=value
    )


def _changed(settings: ReadSettings, text: str, **change: object) -> Alternative:
    ((name, value),) = change.items()
    if isinstance(value, tuple):
        value = f"[{','.join(f'{number:g}' for number in value)}]"
    return Alternative(text, f"{name}={value}", replace(settings, **change))  # type: ignore[arg-type]


def _rolled(code: str) -> set[str]:
    """The codes of a camera turned about its optical axis: the images turned, said otherwise."""
    quarter = str.maketrans("rdlu", "dlur")
    turns, turned = set(), code
    for _ in range(3):
        turned = turned.translate(quarter)
        turns.add(turned)
    return turns
