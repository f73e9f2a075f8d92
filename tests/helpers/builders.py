"""Builders of scenes that go well and badly, in processes of their own."""

import os
import signal
from pathlib import Path

import torch

from tf_lab.errors import TFLabError


def build(directory: Path, content: str = "whole") -> None:
    """Tells what was built and by which process."""
    (directory / "first.txt").write_text(content)
    assert directory.name.startswith(".")  # not by its final name while it is half-written
    (directory / "process.txt").write_text(str(os.getpid()))


def fail(directory: Path) -> None:
    (directory / "first.txt").write_text("half")
    raise TFLabError("frame-7.jpg: cannot be read")


def die(directory: Path) -> None:
    """As where the system ends a process that takes too much memory."""
    (directory / "first.txt").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)


def exhaust(directory: Path) -> None:
    raise torch.OutOfMemoryError("CUDA out of memory")


def crash(directory: Path) -> None:
    (directory / "first.txt").write_text("half")
    raise ValueError("a bug")
