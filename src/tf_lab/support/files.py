"""Writing files so that a half-written one never passes for a whole one."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import multiprocessing
import os
import re
import shutil
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tf_lab.errors import TFLabError

MOST_NAME = 180  # bytes; file systems take 255, and suffixes come behind it
_UNFIT = re.compile(r"[\x00-\x1f\x7f/\\]|^\.")


def file_name(name: object) -> str:
    """A name out of a file's content as the name of a file, which cannot leave its folder.

    Ordinary names stay as they are. Of others, what no file name may hold becomes ``_``, and a hash
    of the name follows, so that different names stay different.
    """
    text = str(name)
    fit = _UNFIT.sub("_", text).encode(errors="replace")
    if fit and fit.decode() == text and len(fit) <= MOST_NAME:
        return text
    return told_apart(fit[: MOST_NAME - 9].decode(errors="ignore"), text)


def told_apart(name: str, whole: str) -> str:
    """A name, short for ``whole``, with a hash of that, so that it is of nothing else."""
    digest = hashlib.sha256(whole.encode(errors="surrogatepass")).hexdigest()[:8]
    return f"{name}_{digest}"


def _prefix() -> str:
    """Of temporary names: says who writes (of a pool, its parent), to be known when that died."""
    parent = multiprocessing.parent_process()
    owner = os.getpid() if parent is None else parent.pid
    return f".partial-{socket.gethostname()}-{owner}-"


def remove_abandoned(directory: Path) -> None:
    """Remove the half-written files and folders that killed processes of this machine left."""
    for path in directory.glob(f".partial-{socket.gethostname()}-*"):
        process = path.name.removeprefix(f".partial-{socket.gethostname()}-").split("-")[0]
        if process.isdecimal() and not _is_alive(int(process)):
            ours = directory / (_prefix() + path.name.rpartition("-")[2])
            with contextlib.suppress(OSError):  # another process removes it, too
                path.rename(ours)  # so that nothing is added to it any more
            shutil.rmtree(ours, ignore_errors=True)
            ours.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def check_file(path: Path) -> None:
    """That a file can be written, before the work whose result it is; nothing is left behind.

    Raises:
        TFLabError: it can't.
    """
    if path.is_dir():
        raise TFLabError(f"{path}: is a folder; give the name of a file in it")
    if path.exists() and not path.is_file():  # such as /dev/null
        raise TFLabError(f"{path}: is a device or pipe; give the name of a file, which is written")
    check_folder(path.parent, path)


def check_folder(folder: Path, path: Path | None = None) -> None:
    """That files can be written into a folder, which may not be there yet; nothing is left behind.

    Args:
        folder: the folder.
        path: the file, if only one is meant.

    Raises:
        TFLabError: they can't.
    """
    if path is None and folder.is_file():
        raise TFLabError(f"{folder}: is a file; give a folder, which need not be there yet")
    folder = folder.absolute()
    nearest = next(place for place in (folder, *folder.parents) if os.path.lexists(place))
    try:
        with contextlib.suppress(FileNotFoundError):
            (path or folder).absolute().lstat()  # an error where a name is too long
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        reason = f"{error.strerror}: {nearest}"
        raise TFLabError(
            f"{path or folder}: cannot be written ({reason}); give another place by output="
        ) from error


FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
PROBE = 2**16  # bytes


@contextlib.contextmanager
def telling_no_space(place: Path, final: Path | None = None) -> Iterator[None]:
    """Say in one line that there is no space for a file, whatever its writer makes of that.

    Few writers tell: torch's and safetensors' have errors of their own, numpy's no number. So what
    was to be written, being temporary, is made longer: the error of that is the true one.

    Args:
        place: the file, or the folder of files, that is written in the block.
        final: what it becomes; None: it stays, and is not made longer.

    Raises:
        TFLabError: there is no space for it. All else is raised as it is.
    """
    try:
        yield
    except TFLabError as error:
        if final is None or str(place) not in str(error):
            raise
        raise TFLabError(str(error).replace(str(place), str(final))) from error
    except Exception as error:
        newest = _newest(place)
        full = _full(error) or (_full(_grown(newest)) if final and newest else None)
        if full is None:
            raise
        name = final or place
        if newest is not None and newest != place:
            name /= newest.relative_to(place)
        raise TFLabError(
            f"{name}: there is no space for it ({full.strerror}); what was finished is kept, make "
            "room and give the same command again"
        ) from error


def _full(error: BaseException | None) -> OSError | None:
    """The error in a chain of them by which the system says that there is no space."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in FULL:
            return error
        told = re.search(r"\(os error (\d+)\)", str(error))  # by Rust, as in safetensors
        if told and (number := int(told[1])) in FULL:
            return OSError(number, os.strerror(number))
        error = error.__cause__ or error.__context__
    return None


def _newest(place: Path) -> Path | None:
    files = [place] if place.is_file() else [p for p in place.rglob("*") if p.is_file()]
    return max(files, key=lambda path: path.stat().st_mtime_ns, default=None)


def _grown(file: Path) -> OSError | None:
    """What the system says to a longer file."""
    try:
        with file.open("ab") as stream:
            stream.write(bytes(PROBE))
    except OSError as error:
        return error
    return None


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that replaces it when the block ends without an error.

    Where ``path`` is a link, what it leads to is replaced. The temporary name keeps the suffix,
    because many writers choose the format by it.

    Raises:
        TFLabError: there is no space for it.
    """
    if path.is_symlink():
        path = path.resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=_prefix(), suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        with telling_no_space(temporary, path):
            yield temporary
            temporary.chmod(0o644)
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_directory(path: Path) -> Iterator[Path]:
    """A temporary directory beside ``path`` that becomes it when the block ends without an error.

    If ``path`` exists by then (another process was faster), that one stays.

    Raises:
        TFLabError: there is no space for it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=_prefix(), dir=path.parent))
    temporary.chmod(0o755)
    try:
        with telling_no_space(temporary, path):
            yield temporary
            try:
                temporary.rename(path)
            except OSError:
                if not path.is_dir():
                    raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def write_text(path: Path, text: str) -> None:
    """Write text atomically, as UTF-8."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically, human-readable."""
    write_text(path, json.dumps(value, indent=2) + "\n")


def remove_directory(path: Path) -> None:
    """Remove a directory, through a link too; what is half removed never passes for a whole one."""
    if path.is_symlink():
        link, path = path, path.resolve()
        link.unlink()
    remove_abandoned(path.parent)
    temporary = path.with_name(_prefix() + path.name)
    path.rename(temporary)
    shutil.rmtree(temporary)
