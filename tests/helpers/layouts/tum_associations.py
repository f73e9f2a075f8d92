"""The layout of `tum`, its images listed in associations.txt: depth first, as fovis has it."""

from collections.abc import Sequence
from pathlib import Path

from helpers.layouts import tum
from helpers.layouts.tum import OPTIONS as OPTIONS
from tf_lab.data.scene import Frame


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    tum.write(directory, frames)
    colors, depths = (
        [line for line in (directory / f"{name}.txt").read_text().splitlines() if line[0] != "#"]
        for name in ("rgb", "depth")
    )
    lines = [f"{depth} {color}\n" for color, depth in zip(colors, depths, strict=True)]
    (directory / "associations.txt").write_text("".join(lines))
    for name in ("rgb.txt", "depth.txt"):
        (directory / name).unlink()
    return directory
