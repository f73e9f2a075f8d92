"""A ScanNet scene as its ``.sens`` stream, written from the published description of the format."""

import io
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings()  # the format says where down is
RAW, PNG, JPEG = 0, 1, 2
RAW_USHORT, ZLIB_USHORT = 0, 1


def numbers(matrix: np.ndarray) -> bytes:
    return struct.pack("<16f", *np.asarray(matrix).ravel())


def intrinsics(K: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = K
    return matrix


@dataclass
class Stream:
    """A stream in memory; every declared value can be made to lie."""

    color_K: np.ndarray
    color_size: tuple[int, int]
    depth_K: np.ndarray
    depth_size: tuple[int, int]
    version: int = 4
    sensor: bytes = b"StructureSensor (calibrated)"
    color_extrinsics: np.ndarray = field(default_factory=lambda: np.eye(4))
    depth_extrinsics: np.ndarray = field(default_factory=lambda: np.eye(4))
    color_coding: int = PNG
    depth_coding: int = ZLIB_USHORT
    depth_shift: float = 1000.0
    frames: list[bytes] = field(default_factory=list)
    count: int | None = None

    def add(self, image: np.ndarray, depth: np.ndarray, pose: np.ndarray) -> None:
        """A frame of uint8 [H, W, 3], uint16 [h, w] and camera-to-world [4, 4]."""
        self.add_coded(self.color_bytes(image), self.depth_bytes(depth), pose)

    def add_coded(
        self, color: bytes, depth: bytes, pose: np.ndarray, sizes: tuple[int, int] | None = None
    ) -> None:
        color_size, depth_size = sizes or (len(color), len(depth))
        time = 33333 * len(self.frames)
        head = numbers(pose) + struct.pack("<QQQQ", time, time + 1, color_size, depth_size)
        self.frames.append(head + color + depth)

    def color_bytes(self, image: np.ndarray) -> bytes:
        if self.color_coding == RAW:
            return image.tobytes()
        data = io.BytesIO()
        if self.color_coding == PNG:
            Image.fromarray(image).save(data, "PNG")
        else:
            Image.fromarray(image).save(data, "JPEG", quality=95)
        return data.getvalue()

    def depth_bytes(self, depth: np.ndarray) -> bytes:
        values = depth.astype("<u2").tobytes()
        return zlib.compress(values, 8) if self.depth_coding == ZLIB_USHORT else values

    def header(self) -> bytes:
        count = len(self.frames) if self.count is None else self.count
        return b"".join(
            [
                struct.pack("<IQ", self.version, len(self.sensor)),
                self.sensor,
                numbers(intrinsics(self.color_K)),
                numbers(self.color_extrinsics),
                numbers(intrinsics(self.depth_K)),
                numbers(self.depth_extrinsics),
                struct.pack("<ii", self.color_coding, self.depth_coding),
                struct.pack("<IIII", *self.color_size, *self.depth_size),
                struct.pack("<fQ", self.depth_shift, count),
            ]
        )

    def write(self, path: Path) -> Path:
        imu = struct.pack("<Q", 1) + bytes(5 * 3 * 8) + struct.pack("<Q", 7)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(self.header() + b"".join(self.frames) + imu)
        return path


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    size = (frames[0].image.shape[1], frames[0].image.shape[0])
    stream = Stream(frames[0].K, size, frames[0].K, size)
    for frame in frames:
        stream.add(frame.image, np.round(frame.depth * 1000), frame.world_T_cam)
    return stream.write(directory / f"{directory.name}.sens")
