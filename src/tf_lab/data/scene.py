"""A scene on disk: frames stored once, with cameras, provenance and (if known) ground truth.

Layout of a scene directory::

    scene.json           format version, name, image size, provenance, skipped frames
    cameras.npz          K [N,3,3], world_T_cam [N,4,4], frames [N], source_T_world [4,4]
    color/<frame>.jpg    RGB
    depth/<frame>.png    16-bit millimetres, 0 = no reading (absent without depth)
    groundtruth/         see `groundtruth.py` (absent without ground truth)
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from tf_lab.data.capture import read_depth, read_image
from tf_lab.data.lens import camera_of
from tf_lab.errors import TFLabError
from tf_lab.geometry import is_valid_pose
from tf_lab.support.arrays import read_arrays
from tf_lab.support.files import file_name, write_json
from tf_lab.support.records import read_record

FORMAT = 2
CURE = "delete the scene and prepare it again"


@dataclass(frozen=True)
class Description:
    """What ``scene.json`` holds."""

    format: int
    name: str
    size: tuple[int, int]
    provenance: dict[str, Any]
    skipped: list[str]


@dataclass(frozen=True)
class Frame:
    """One posed image: uint8 [H,W,3], K [3,3], world_T_cam [4,4], depth float32 [H,W] or None."""

    name: str
    image: np.ndarray
    K: np.ndarray
    world_T_cam: np.ndarray
    depth: np.ndarray | None = None


def write_scene(
    directory: Path,
    frames: Iterable[Frame],
    provenance: dict[str, Any],
    name: str,
    skipped: Sequence[str] = (),
    source_T_world: np.ndarray | None = None,
) -> Scene:
    """Write frames as a scene directory (not atomic: give a temporary directory) and open it.

    Args:
        directory: must not exist, or be empty.
        frames: of one image size; read one at a time.
        provenance: where it is from.
        name: of the scene.
        skipped: "frame: reason" of what was left out; read after the frames, which may add to it.
        source_T_world: [4, 4], see `Capture`.

    Raises:
        TFLabError: there is no frame.
    """
    (directory / "color").mkdir(parents=True)
    names, Ks, poses, size = [], [], [], (0, 0)
    for frame in frames:
        size = (frame.image.shape[1], frame.image.shape[0])
        Image.fromarray(frame.image).save(_color(directory, frame.name), quality=95)
        if frame.depth is not None:
            (directory / "depth").mkdir(exist_ok=True)
            millimetres = np.round(frame.depth * 1000).clip(0, 65534).astype(np.uint16)
            Image.fromarray(millimetres).save(_depth(directory, frame.name))
        names.append(frame.name)
        Ks.append(frame.K)
        poses.append(frame.world_T_cam)
    if not names:
        reason = f"; the first: {skipped[0]}" if skipped else ""
        raise TFLabError(f"{name}: no usable frame{reason}")
    np.savez(
        directory / "cameras.npz",
        K=np.asarray(Ks, np.float64),
        world_T_cam=np.asarray(poses, np.float64),
        frames=np.asarray(names),
        source_T_world=np.eye(4) if source_T_world is None else source_T_world,
    )
    meta = Description(FORMAT, name, size, provenance, list(skipped))
    write_json(directory / "scene.json", asdict(meta))
    return Scene(directory)


def _color(directory: Path, frame: str) -> Path:
    return directory / "color" / f"{file_name(frame)}.jpg"


def _depth(directory: Path, frame: str) -> Path:
    return directory / "depth" / f"{file_name(frame)}.png"


class Scene:
    """A scene directory, opened: a `Capture` whose images lie in one known layout.

    Raises:
        TFLabError: the directory is missing, incomplete or of another format version.
    """

    def __init__(self, directory: Path | str) -> None:
        self.directory = Path(directory)
        parts = [self.directory / name for name in ("scene.json", "cameras.npz")]
        if self.directory.is_dir() and not any(part.exists() for part in parts):
            raise TFLabError(
                f"{self.directory}: no scene.json of a prepared scene; a capture is opened by "
                "`tf_lab.open_capture`, and given as input="
            )
        try:
            meta = read_record(Description, self.directory / "scene.json", CURE)
            if meta.format != FORMAT:
                raise TFLabError(
                    f"{self.directory}: scene format {meta.format}, expected {FORMAT}; {CURE}"
                )
            cameras = read_arrays(self.directory / "cameras.npz", CURE)
            self.frames = [str(name) for name in cameras["frames"].tolist()]
            self.K, self.world_T_cam = cameras["K"], cameras["world_T_cam"]
            self.source_T_world = cameras["source_T_world"]
            self.name, self.size = meta.name, meta.size
            self.provenance, self.skipped = meta.provenance, meta.skipped
            self._check_cameras()
        except (KeyError, TypeError, ValueError) as error:
            raise TFLabError(
                f"{self.directory / 'cameras.npz'}: damaged ({error}); {CURE}"
            ) from error

    def _check_cameras(self) -> None:
        """That there is a camera for each frame. Raises ValueError or TFLabError: there is not."""
        count = len(self.frames)
        for name, shape in (("K", (count, 3, 3)), ("world_T_cam", (count, 4, 4))):
            found = getattr(self, name)
            if found.shape != shape or found.dtype.kind != "f" or not count:
                raise ValueError(f"{name} is {found.dtype} {list(found.shape)}, not {list(shape)}")
        if self.source_T_world.shape != (4, 4) or not np.isfinite(self.source_T_world).all():
            raise ValueError("source_T_world is no transform")
        if not is_valid_pose(torch.from_numpy(self.world_T_cam)).all():
            raise ValueError("a pose in world_T_cam is no rigid transform")
        for K in np.unique(self.K, axis=0):
            camera_of(K, self.size)

    def __len__(self) -> int:
        return len(self.frames)

    def image(self, index: int) -> np.ndarray:
        """uint8 [H, W, 3] RGB. Raises TFLabError, naming file and cure, if it can't be read."""
        with self._repairable():
            return read_image(_color(self.directory, self.frames[index]))

    def jpeg(self, index: int) -> bytes:
        """The file of an image as it is stored. Raises TFLabError, as `image` does."""
        path = _color(self.directory, self.frames[index])
        try:
            return path.read_bytes()
        except OSError as error:
            raise TFLabError(
                f"{path}: cannot be read ({error}); delete {self.directory} and prepare it again"
            ) from error

    def depth(self, index: int) -> np.ndarray | None:
        """float32 [H, W] camera z in metres, 0 where unknown; None without depth."""
        path = _depth(self.directory, self.frames[index])
        with self._repairable():
            return read_depth(path) if path.exists() else None

    @contextmanager
    def _repairable(self) -> Iterator[None]:
        """Adds the cure to an error of reading a file."""
        try:
            yield
        except TFLabError as error:
            raise TFLabError(f"{error}; delete {self.directory} and prepare it again") from error

    @property
    def groundtruth(self) -> Path:
        """The directory of the scene's ground truth."""
        return self.directory / "groundtruth"


@lru_cache(maxsize=256)
def cached_scene(directory: Path) -> Scene:
    """A scene that many draws open."""
    return Scene(directory)
