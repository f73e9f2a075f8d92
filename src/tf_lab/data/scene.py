"""A scene on disk: frames stored once, with cameras, provenance and (if known) ground truth.

Layout of a scene directory::

    scene.json           format version, name, image size, provenance, skipped frames
    cameras.npz          K [N,3,3], world_T_cam [N,4,4], frames [N], source_T_world [4,4]
    color/<frame>.jpg    RGB
    depth/<frame>.png    16-bit millimetres, 0 = no reading (absent without depth)
    groundtruth/         see `groundtruth.py` (absent without ground truth)
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tf_lab.data.capture import read_depth, read_image
from tf_lab.errors import TFLabError
from tf_lab.support.files import write_json

FORMAT = 2


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
        Image.fromarray(frame.image).save(directory / "color" / f"{frame.name}.jpg", quality=95)
        if frame.depth is not None:
            (directory / "depth").mkdir(exist_ok=True)
            millimetres = np.round(frame.depth * 1000).clip(0, 65534).astype(np.uint16)
            Image.fromarray(millimetres).save(directory / "depth" / f"{frame.name}.png")
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
    meta = {
        "format": FORMAT,
        "name": name,
        "size": size,
        "provenance": provenance,
        "skipped": list(skipped),
    }
    write_json(directory / "scene.json", meta)
    return Scene(directory)


class Scene:
    """A scene directory, opened: a `Capture` whose images lie in one known layout.

    Raises:
        TFLabError: the directory is missing, incomplete or of another format version.
    """

    def __init__(self, directory: Path | str) -> None:
        self.directory = Path(directory)
        meta_file = self.directory / "scene.json"
        try:
            meta = json.loads(meta_file.read_text())
            self._check_format(meta["format"])
            with np.load(self.directory / "cameras.npz") as cameras:
                self.K = cameras["K"]
                self.world_T_cam = cameras["world_T_cam"]
                self.frames = [str(name) for name in cameras["frames"]]
                self.source_T_world = cameras["source_T_world"]
            self.name: str = meta["name"]
            self.size: tuple[int, int] = (meta["size"][0], meta["size"][1])
            self.provenance: dict[str, Any] = meta["provenance"]
            self.skipped: list[str] = meta["skipped"]
        except FileNotFoundError as error:
            raise TFLabError(f"{error.filename}: missing; prepare the scene again") from error
        except TFLabError:
            raise
        except Exception as error:  # any damage: json, zip, keys
            raise TFLabError(
                f"{self.directory}: the scene is damaged ({error}); delete it and prepare it again"
            ) from error

    def _check_format(self, found: int) -> None:
        if found != FORMAT:
            raise TFLabError(
                f"{self.directory}: scene format {found}, expected {FORMAT}; delete it and "
                "prepare it again"
            )

    def __len__(self) -> int:
        return len(self.frames)

    def image(self, index: int) -> np.ndarray:
        """uint8 [H, W, 3] RGB. Raises TFLabError, naming file and cure, if it can't be read."""
        with self._repairable():
            return read_image(self._color_file(index))

    def jpeg(self, index: int) -> bytes:
        """The file of an image as it is stored. Raises TFLabError, as `image` does."""
        path = self._color_file(index)
        try:
            return path.read_bytes()
        except OSError as error:
            raise TFLabError(
                f"{path}: cannot be read ({error}); delete {self.directory} and prepare it again"
            ) from error

    def _color_file(self, index: int) -> Path:
        return self.directory / "color" / f"{self.frames[index]}.jpg"

    def depth(self, index: int) -> np.ndarray | None:
        """float32 [H, W] camera z in metres, 0 where unknown; None without depth."""
        path = self.directory / "depth" / f"{self.frames[index]}.png"
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
