"""Tries damaged copies of a kind of files, and tells what was not answered by a clear error."""

import contextlib
import os
import resource
import shutil
import signal
import tempfile
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from helpers.fuzz.archives import change_tar
from helpers.fuzz.kinds import KINDS
from helpers.fuzz.mutations import (
    MUTATIONS,
    Mutation,
    change_arrays,
    change_document,
    change_header,
    flip_bits,
    pick,
    resize_jpeg,
    resize_png,
)
from tf_lab.errors import TFLabError

SECONDS = 20  # of CPU for one input; ten times as long by the clock
MEMORY = 4 * 2**30  # address space, beyond what is in use at the start


STRUCTURED: dict[str, Mutation] = {
    ".json": change_document,
    ".yaml": change_document,
    ".safetensors": change_header,
    ".npy": change_arrays,
    ".npz": change_arrays,
    ".tar": change_tar,
    ".png": resize_png,
    ".jpg": resize_jpeg,
}


def limit_memory() -> None:
    """Of this process, from here on."""
    in_use = resource.getpagesize() * int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (in_use + MEMORY, in_use + MEMORY))


def _limit_time(seconds: int) -> None:
    """Of what follows; 0: as long as it likes."""
    for number in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(number, _too_slow)
    signal.alarm(10 * seconds)
    signal.setitimer(signal.ITIMER_PROF, seconds)


def _too_slow(*_: object) -> None:
    raise TimeoutError(f"more than {SECONDS} s")


def mutate(folder: Path, rng: np.random.Generator) -> list[str]:
    """Damage one or two files of a folder; what was done."""
    done = []
    for _ in range(rng.integers(1, 3)):
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        if not files:
            break  # the only one was removed
        path = pick(files, rng)
        own = STRUCTURED.get(path.suffix)
        plain = own is None or rng.random() < 0.4
        mutation = MUTATIONS[rng.integers(len(MUTATIONS))] if plain or own is None else own
        done.append(f"{mutation.__name__} {path.relative_to(folder)}")
        try:
            mutation(path, rng)
        except Exception:  # damaged before, so that its format has no words for it any more
            if path.is_file():
                flip_bits(path, rng)
    return done


def campaign(kind: str, count: int, first: int = 0) -> dict[str, Any]:
    """Try ``count`` damaged copies, of seeds from ``first``.

    Returns:
        count, how many were ``refused`` in whole or in part, the slowest (seconds of CPU), and the
        ``failures``: seed, what was done, and what happened.
    """
    failures: list[dict[str, Any]] = []
    refused, slowest = 0, 0.0
    with tempfile.TemporaryDirectory() as place:
        root = Path(place)
        whole, copy = root / "whole", root / "inner" / "copy"
        whole.mkdir()
        KINDS[kind].write(whole)
        assert not KINDS[kind].read(whole), "the whole files are refused"
        for path in whole.rglob("report"):
            shutil.rmtree(path)
        copy.parent.mkdir()
        for seed in range(first, first + count):
            shutil.copytree(whole, copy)
            done = mutate(copy, np.random.default_rng(seed))
            start, wrong = time.process_time(), None
            for note in root.glob("*.opened"):
                shutil.copy(note, copy.parent)
            with _inside(copy.parent):
                _limit_time(SECONDS)
                try:
                    refused += KINDS[kind].read(copy)
                except TFLabError as error:
                    assert str(error)
                    refused += 1
                except Exception:  # what this is about
                    wrong = traceback.format_exc()[-1500:]
                finally:
                    _limit_time(0)
            slowest = max(slowest, time.process_time() - start)
            outside = {p.name for p in [*root.iterdir(), *copy.parent.iterdir()]}
            strange = {
                n for n in outside if n not in ("whole", "inner", "copy") and ".opened" not in n
            }
            if strange:
                wrong = f"wrote {sorted(strange)} outside of its folder"
                for path in [*root.iterdir(), *copy.parent.iterdir()]:
                    if path.name in strange:
                        shutil.rmtree(path) if path.is_dir() else path.unlink()
            if wrong:
                failures.append({"seed": seed, "did": done, "error": wrong})
            shutil.rmtree(copy)
    return {"count": count, "refused": refused, "slowest": slowest, "failures": failures}


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    """With another working directory, and without what is printed."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        with (
            Path(os.devnull).open("w") as nowhere,
            contextlib.redirect_stdout(nowhere),
            contextlib.redirect_stderr(nowhere),
        ):
            yield
    finally:
        os.chdir(before)
