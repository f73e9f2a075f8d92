"""Arrays of numbers or texts from disk: no code in them runs, and none is larger than its file."""

from __future__ import annotations

import errno
import io
import zipfile
from pathlib import Path

import numpy as np

from tf_lab.errors import TFLabError

MOST_UNPACKED = 2**30  # bytes of an .npz


class TooManyFilesError(TFLabError):
    """As many files are open as the system allows."""


def read_array(path: Path, cure: str) -> np.ndarray:
    """What an .npy file holds; mapped, so that what is not used is not read.

    Raises:
        TFLabError: it is missing, damaged, or holds objects.
    """
    try:
        return np.lib.format.open_memmap(path, mode="r")  # its size is held against the file's
    except FileNotFoundError as error:
        raise TFLabError(f"{path}: missing; {cure}") from error
    except Exception as error:  # whatever the damage leads to
        if getattr(error, "errno", None) in (
            errno.EMFILE,
            errno.ENFILE,
        ):  # nothing is wrong with it
            raise TooManyFilesError(
                f"{path}: too many open files; allow more (`ulimit -n 4096`)"
            ) from error
        raise TFLabError(f"{path}: cannot be read as an array ({error}); {cure}") from error


def read_arrays(path: Path, cure: str) -> dict[str, np.ndarray]:
    """What an .npz file holds, by name.

    Raises:
        TFLabError: it is missing, damaged, too large, or holds objects.
    """
    try:
        with zipfile.ZipFile(path) as file:
            members = file.infolist()
            size = sum(member.file_size for member in members)
            if size > MOST_UNPACKED:
                raise ValueError(f"{size / 2**30:.1f} GiB unpacked")
            return {
                member.filename.removesuffix(".npy"): _array(file.read(member))
                for member in members
            }
    except FileNotFoundError as error:
        raise TFLabError(f"{path}: missing; {cure}") from error
    except Exception as error:  # whatever the damage leads to
        raise TFLabError(f"{path}: damaged ({error}); {cure}") from error


def _array(content: bytes) -> np.ndarray:
    """An array in .npy format. Raises ValueError: it is none, or not as large as it says."""
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    read = {(1, 0): np.lib.format.read_array_header_1_0}.get(
        version, np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read(file)
    if np.prod(shape, dtype=object) * dtype.itemsize != len(content) - file.tell():
        raise ValueError(f"it says {dtype} {list(shape)}, and holds something else")
    return np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
