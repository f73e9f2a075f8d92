"""A full disk is one line that names the file, whoever writes it; what was there before stays."""

import errno
import resource
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import save_file

from tf_lab.errors import TFLabError
from tf_lab.support.files import atomic_directory, atomic_path, telling_no_space, write_json
from tf_lab.training.fit import AtomicSaves

LIMIT = 20_000  # bytes a file may have
NUMBERS = np.random.default_rng(0).integers(0, 255, (100, 100, 3), np.uint8)


@pytest.fixture
def full() -> Iterator[None]:
    """As on a full disk, only that it is "File too large" which the system says."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def as_torch(path: Path) -> None:
    AtomicSaves().save_checkpoint({"x": torch.from_numpy(NUMBERS)}, path)


def as_safetensors(path: Path) -> None:
    with atomic_path(path) as temporary:
        save_file({"x": torch.from_numpy(NUMBERS)}, temporary)


def as_numpy(path: Path) -> None:
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.save(file, NUMBERS)


def as_image(path: Path) -> None:
    with atomic_path(path) as temporary:
        Image.fromarray(NUMBERS).save(temporary, format="png")


def as_text(path: Path) -> None:
    write_json(path, NUMBERS.tolist())


@pytest.mark.usefixtures("full")
@pytest.mark.parametrize("write", [as_torch, as_safetensors, as_numpy, as_image, as_text])
def test_every_writer(write: Callable[[Path], None], tmp_path: Path) -> None:
    path = tmp_path / "result.png"
    path.write_text("as it was")
    with pytest.raises(TFLabError) as told:
        write(path)
    assert str(told.value).startswith(f"{path}: there is no space for it (File too large); ")
    assert "\n" not in str(told.value)
    assert [p.name for p in tmp_path.iterdir()] == ["result.png"]
    assert path.read_text() == "as it was"


@pytest.mark.usefixtures("full")
@pytest.mark.parametrize("write", [as_numpy, as_text])
def test_a_file_in_a_folder(write: Callable[[Path], None], tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    with pytest.raises(TFLabError, match=f"^{scene}/tsdf.npy: there is no space for it"):  # noqa: SIM117
        with atomic_directory(scene) as temporary:
            (temporary / "first.txt").write_text("fits")
            write(temporary / "tsdf.npy")
    assert list(tmp_path.iterdir()) == []


def test_other_errors_stay_what_they_are(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a bug"), atomic_path(tmp_path / "a") as temporary:
        temporary.write_text("there is space")
        raise ValueError("a bug")
    log = tmp_path / "log.csv"
    log.write_text("step,loss\n")
    with pytest.raises(OSError, match="odd"), telling_no_space(tmp_path):
        raise OSError(errno.EIO, "odd")
    with pytest.raises(TFLabError, match=r"log.csv: there is no space"), telling_no_space(tmp_path):
        raise OSError(errno.ENOSPC, "No space left on device")  # of Lightning's logger
    assert log.read_text() == "step,loss\n"
    assert [p.name for p in tmp_path.iterdir()] == ["log.csv"]
