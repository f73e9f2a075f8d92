"""Frames of video files by their number, exactly: decoded in order, never sought.

Seeking by time or key frame is off by frames in many files, so frame i is the i-th that the
decoder gives, as for every tool that extracts all frames. Going forward decodes on; going back
takes up an earlier decoder that is still before the frame, or starts another.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tf_lab.errors import TFLabError

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")
DECODERS = 3  # open at most: pairs of frames and readers side by side go to and fro
CURE = "convert it with ffmpeg to an .mp4, or extract its frames into images/"


class Video:
    """A video file. May be pickled; threads take turns.

    Args:
        path: the file.
        upright: turn the frames as the file's metadata ask for (phones held upright store them
            lying), as players and ffmpeg do; False gives the pixels as the sensor has them.

    Attributes:
        size: (width, height) of the frames.

    Raises:
        TFLabError: it cannot be opened.
    """

    def __init__(self, path: Path, upright: bool = True) -> None:
        self.path = path
        self.upright = upright
        self._turn = threading.Lock()
        self._end: int | None = None  # no frame from here on can be decoded
        self._decoders = [self._start()]  # the one used last is last
        capture = self._decoders[0].capture
        width, height = (
            capture.get(side) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        self.size = (int(width), int(height))
        self._declared = capture.get(cv2.CAP_PROP_FRAME_COUNT)

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in ("_decoders", "_turn")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _decoders=[], _turn=threading.Lock())

    def read(self, index: int) -> np.ndarray:
        """Frame ``index`` from 0, uint8 [H, W, 3] RGB. Raises TFLabError if it can't be decoded."""
        with self._turn, _quiet():
            try:
                decoder = self._reach(index)
                image = decoder.capture.retrieve()[1] if decoder else None
                if image is not None:
                    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
            except cv2.error:
                pass
        raise TFLabError(f"{self.path}: frame {index} cannot be decoded; {CURE}")

    def count(self, expected: int) -> int:
        """The number of frames, as far as it matters: more than one too many are not counted.

        What the file declares is believed if it is ``expected``. Some files only declare an
        estimate: otherwise all frames are decoded, which takes a while.
        """
        if self._declared == expected:
            return expected
        with self._turn, _quiet():
            self._reach(expected)
            return expected + 1 if self._end is None else min(self._end, expected + 1)

    def _start(self) -> _Decoder:
        with _quiet():
            capture = cv2.VideoCapture(str(self.path.resolve()), cv2.CAP_FFMPEG)
            capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, float(self.upright))
        if not capture.isOpened():
            if not self.path.is_file():
                raise TFLabError(f"{self.path}: no such video")
            raise TFLabError(f"{self.path}: cannot be read as a video; {CURE}")
        return _Decoder(capture)

    def _reach(self, index: int) -> _Decoder | None:
        """A decoder that holds frame ``index``, after decoding up to it; None: there is no such."""
        if self._end is not None and index >= self._end:
            return None
        before = [decoder for decoder in self._decoders if decoder.position <= index]
        if before:
            decoder = max(before, key=lambda it: it.position)
            self._decoders.remove(decoder)
        else:
            decoder = self._start()
        while decoder.position < index:
            if not decoder.capture.grab():
                # it may go on after a failure, but with which frame nobody knows
                self._end = decoder.position + 1
                return None
            decoder.position += 1
        self._decoders = [*self._decoders[1 - DECODERS :], decoder]
        return decoder


@dataclass(eq=False)
class _Decoder:
    """An open video, and the number of the frame that it holds; -1: none yet."""

    capture: cv2.VideoCapture
    position: int = -1


@dataclass(frozen=True)
class VideoFrame:
    """uint8 [H, W, 3] of a frame of a video."""

    video: Video
    index: int

    def __call__(self) -> np.ndarray:
        """Decode it."""
        return self.video.read(self.index)

    def __str__(self) -> str:
        return f"{self.video.path}, frame {self.index}"


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the decoder's own complaints: they have their exception."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET; read once, by OpenCV
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)
