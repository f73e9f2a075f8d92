"""Builders of scenes that go well and badly, in processes of their own."""

import os
import signal
import time
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


def need_it_all(directory: Path) -> None:
    """As where a GPU's memory is enough for one: fails while another process does this, too."""
    alone = directory.parent / "alone"
    try:
        alone.touch(exist_ok=False)
    except FileExistsError as error:
        raise torch.AcceleratorError("CUDA error: out of memory") from error
    time.sleep(0.5)
    build(directory)
    alone.unlink()


def crash(directory: Path) -> None:
    (directory / "first.txt").write_text("half")
    raise ValueError("a bug")
