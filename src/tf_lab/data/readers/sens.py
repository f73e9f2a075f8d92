"""ScanNet's ``.sens`` stream, version 4: a header, then RGB-D frames, then IMU samples (not read).

All numbers are little-endian; matrices are 4x4 float32, row by row::

    uint32 version; uint64 length, sensor name
    colour intrinsics, colour extrinsics, depth intrinsics, depth extrinsics
    int32 colour coding (0 raw RGB, 1 PNG, 2 JPEG), int32 depth coding (0 raw uint16, 1 zlib)
    uint32 colour width, height, depth width, height; float32 depth units a metre
    uint64 number of frames, and each of them:
        pose; uint64 time of colour, of depth; uint64 bytes of colour, of depth; colour; depth

Such files have gigabytes: opening one reads the frames' heads, an image is read when asked for.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np

from tf_lab.data.capture import MAX_PIXELS, decode_image, metres
from tf_lab.errors import TFLabError

VERSION = 4
RAW, PNG, JPEG = 0, 1, 2
RAW_DEPTH, ZLIB_DEPTH = 0, 1
MOST_FRAMES = 100_000  # ScanNet's longest scans have a tenth of that
MAX_NAME = 4096  # bytes of the sensor's name
MAX_SCALE = 1e6  # depth units a metre
CURE = "download it again, or have it written by ScanNet's tools"

_NAME = struct.Struct("<IQ")
_HEADER = struct.Struct("<64f2i4IfQ")
_FRAME = struct.Struct("<16f4Q")


@dataclass(frozen=True)
class Block:
    """The bytes of one image in a file, as a frame's head states them."""

    path: Path
    frame: int
    offset: int
    length: int

    def bytes(self) -> bytes:
        """Read them. Raises TFLabError if the file has them no more."""
        try:
            with self.path.open("rb") as file:
                file.seek(self.offset)
                data = file.read(self.length)
        except OSError as error:
            raise TFLabError(f"{self}: cannot be read ({error})") from error
        if len(data) < self.length:
            raise TFLabError(f"{self}: the file has become shorter; {CURE}")
        return data

    def __str__(self) -> str:
        return f"{self.path}, frame {self.frame}"


@dataclass(frozen=True)
class SensColor:
    """uint8 [H, W, 3] of one frame."""

    block: Block
    coding: int
    size: tuple[int, int]

    def __call__(self) -> np.ndarray:
        """Decode it."""
        data, (width, height) = self.block.bytes(), self.size
        if self.coding != RAW:
            return decode_image(BytesIO(data), self, self.size)
        if len(data) != width * height * 3:
            raise TFLabError(f"{self}: {len(data)} bytes are no {width}x{height} RGB image; {CURE}")
        return np.frombuffer(data, np.uint8).reshape(height, width, 3)

    def __str__(self) -> str:
        return f"{self.block}, colour"


@dataclass(frozen=True)
class SensDepth:
    """float32 [h, w] metres of one frame; 0 and 65535 mean "no reading" and give 0."""

    block: Block
    coding: int
    size: tuple[int, int]
    scale: float

    def __call__(self) -> np.ndarray:
        """Decode it."""
        data, (width, height) = self.block.bytes(), self.size
        length = width * height * 2
        if self.coding == ZLIB_DEPTH:
            data = self._inflate(data, length)
        if len(data) != length:
            raise TFLabError(f"{self}: is not {width}x{height} 16-bit values; {CURE}")
        raw = np.frombuffer(data, "<u2").reshape(height, width)
        return metres(raw, self.scale)

    def _inflate(self, data: bytes, length: int) -> bytes:
        stream = zlib.decompressobj()
        try:
            values = stream.decompress(data, length + 1)  # however much there is
        except zlib.error as error:
            raise TFLabError(f"{self}: is damaged ({error}); {CURE}") from error
        if len(values) == length and not stream.eof:
            raise TFLabError(f"{self}: is cut off; {CURE}")
        return values

    def __str__(self) -> str:
        return f"{self.block}, depth"


@dataclass(frozen=True)
class SensFrame:
    """One frame: its pose [4, 4] as stored (-inf: lost), and where its images are."""

    pose: np.ndarray
    color: SensColor
    depth: SensDepth | None


@dataclass(frozen=True)
class SensHeader:
    """What holds for all frames. Matrices are [4, 4], sizes (width, height) in pixels.

    Attributes:
        color_K, depth_K: intrinsics, pixels.
        color_extrinsics, depth_extrinsics: from the camera to the common frame of both.
        color_coding, depth_coding: see the module.
        color_size, depth_size: of the images; a depth size of (0, 0): there is no depth.
        depth_scale: units a metre.
        count: how many frames there should be.
    """

    color_K: np.ndarray
    color_extrinsics: np.ndarray
    depth_K: np.ndarray
    depth_extrinsics: np.ndarray
    color_coding: int
    depth_coding: int
    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    depth_scale: float
    count: int


@dataclass(frozen=True)
class SensFile:
    """A `.sens` file, indexed.

    Attributes:
        header: what holds for all frames.
        frames: those that are there whole.
        missing: "frame: reason" or "frames M to N: reason" of those that are not.
    """

    header: SensHeader
    frames: list[SensFrame]
    missing: list[str]


def open_sens(path: Path) -> SensFile:
    """Index a file: its header and the heads of its frames are read, nothing else.

    Raises:
        TFLabError: it cannot be read, is no `.sens` file of version 4, is coded in a way that only
            ScanNet's own software knows, or has not one whole frame.
    """
    if not path.is_file():
        raise TFLabError(f"{path}: no such file")
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            header = _read_header(file, path)
            frames, missing = _index(file, path, header, size)
    except OSError as error:
        raise TFLabError(f"{path}: cannot be read ({error})") from error
    if missing and not frames:
        raise TFLabError(f"{path}: {missing[0]}; {CURE}")
    return SensFile(header, frames, missing)


def _read_header(file: BinaryIO, path: Path) -> SensHeader:
    start = file.read(_NAME.size)
    version, length = _NAME.unpack(start) if len(start) == _NAME.size else (None, 0)
    if version != VERSION:
        found = "too short" if version is None else f"version {version}"
        raise TFLabError(f"{path}: {found}, not a .sens file of version {VERSION}; {CURE}")
    if length > MAX_NAME:
        raise TFLabError(f"{path}: a sensor name of {length} bytes: the file is damaged; {CURE}")
    rest = file.read(length + _HEADER.size)[length:]
    if len(rest) < _HEADER.size:
        raise TFLabError(f"{path}: ends within its header; {CURE}")
    values = _HEADER.unpack(rest)
    color_K, color_extrinsics, depth_K, depth_extrinsics = np.reshape(values[:64], (4, 4, 4))
    header = SensHeader(
        color_K,
        color_extrinsics,
        depth_K,
        depth_extrinsics,
        color_coding=values[64],
        depth_coding=values[65],
        color_size=(values[66], values[67]),
        depth_size=(values[68], values[69]),
        depth_scale=values[70],
        count=values[71],
    )
    _check(header, path)
    return header


def _check(header: SensHeader, path: Path) -> None:
    if header.color_coding not in (RAW, PNG, JPEG):
        raise TFLabError(f"{path}: unknown colour coding {header.color_coding}; {CURE}")
    for name, size in (("colour", header.color_size), ("depth", header.depth_size)):
        none = name == "depth" and size == (0, 0)
        if not (none or 0 < size[0] * size[1] <= MAX_PIXELS):
            raise TFLabError(f"{path}: {name} images of {size[0]}x{size[1]}: damaged; {CURE}")
    if header.depth_size == (0, 0):
        return
    if header.depth_coding not in (RAW_DEPTH, ZLIB_DEPTH):
        raise TFLabError(
            f"{path}: unknown depth coding {header.depth_coding}; write it with zlib depth (1), as "
            "ScanNet's published files"
        )
    if not 1 <= header.depth_scale <= MAX_SCALE:
        raise TFLabError(f"{path}: {header.depth_scale:g} depth units a metre: damaged; {CURE}")


def _index(
    file: BinaryIO, path: Path, header: SensHeader, size: int
) -> tuple[list[SensFrame], list[str]]:
    """The whole frames, and why others are missing; the file is at the first one."""
    limits = _largest(header.color_size, 3), _largest(header.depth_size, 2)
    frames: list[SensFrame] = []
    missing: list[str] = []
    offset = file.tell()
    for i in range(header.count):
        file.seek(offset)
        head = file.read(_FRAME.size)
        if len(head) < _FRAME.size:
            return frames, [*missing, *_rest(i, header, "the file ends before")]
        *pose, _, _, color_bytes, depth_bytes = _FRAME.unpack(head)
        empty = color_bytes == 0
        no_head = empty and math.isfinite(pose[-1]) and pose[-1] != 1  # of a pose or a lost one
        if color_bytes > limits[0] or depth_bytes > limits[1] or no_head:
            return frames, [*missing, *_rest(i, header, "the file is damaged there")]
        start = offset + _FRAME.size
        offset = start + color_bytes + depth_bytes
        if offset > size:
            return frames, [*missing, *_rest(i, header, "the file ends before")]
        if empty:
            missing.append(f"{i}: no colour image in the stream")
            continue
        color = Block(path, i, start, color_bytes)
        depth = Block(path, i, start + color_bytes, depth_bytes)
        frames.append(
            SensFrame(
                np.array(pose, np.float64).reshape(4, 4),
                SensColor(color, header.color_coding, header.color_size),
                SensDepth(depth, header.depth_coding, header.depth_size, header.depth_scale)
                if depth_bytes
                else None,
            )
        )
    return frames, missing


def _largest(size: tuple[int, int], channels: int) -> int:
    """Bytes that no coding of an image exceeds: raw, an eighth more, and a page of metadata."""
    return size[0] * size[1] * channels * 9 // 8 + 65536


def _rest(first: int, header: SensHeader, reason: str) -> list[str]:
    """The same of every frame from the first on; in one of more than can be meant."""
    if header.count > MOST_FRAMES:
        return [f"frames {first} to {header.count - 1}: {reason}"]
    return [f"{frame}: {reason}" for frame in range(first, header.count)]
