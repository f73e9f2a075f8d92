"""Damages copies of a capture and opens them: run as a process of its own, within limits.

python -m helpers.mutate LAYOUT COUNT: prints, as JSON, what was not answered by a clear error.
"""

import json
import resource
import shutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path

import numpy as np

from helpers.layouts import LAYOUTS, room_frames
from tf_lab.data.readers import open_capture
from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame
from tf_lab.errors import TFLabError

SECONDS = 10  # for one input
MEMORY = 3 * 2**30  # address space, beyond what is in use at the start
WORDS = ["nan", "-inf", "1e308", "-1", "0", "99999999999", "2147483648", "x", "", "[]", '"a"', "{}"]
Mutation = Callable[[Path, np.random.Generator], None]


def truncate(path: Path, rng: np.random.Generator) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: rng.integers(0, max(1, len(content)))])


def flip_bits(path: Path, rng: np.random.Generator) -> None:
    content = bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 20) if content else 0):
        content[rng.integers(len(content))] ^= 1 << rng.integers(8)
    path.write_bytes(bytes(content))


def overwrite(path: Path, rng: np.random.Generator) -> None:
    """Where a count or size may be declared: most are near the start."""
    content = bytearray(path.read_bytes())
    at = int(rng.integers(0, max(1, min(len(content), rng.choice([64, 512, 1 << 20])))))
    value = [b"\xff" * 4, b"\xff" * 7 + b"\x7f", b"\x00" * 8, b"\xff\xff\xff\x7f"][rng.integers(4)]
    content[at : at + len(value)] = value
    path.write_bytes(bytes(content))


def replace_word(path: Path, rng: np.random.Generator) -> None:
    """Of a text: one of its words becomes something else."""
    words = path.read_bytes().split(b" ")
    words[rng.integers(len(words))] = str(rng.choice(WORDS)).encode()
    path.write_bytes(b" ".join(words))


def replace_line(path: Path, rng: np.random.Generator) -> None:
    """Of a text: a line is lost, doubled or replaced."""
    lines = path.read_bytes().split(b"\n")
    at = int(rng.integers(len(lines)))
    lines[at : at + 1] = [[], [lines[at]] * 2, [str(rng.choice(WORDS)).encode()]][rng.integers(3)]
    path.write_bytes(b"\n".join(lines))


def replace_all(path: Path, rng: np.random.Generator) -> None:
    path.write_bytes([b"", b"\x00" * 100, rng.bytes(300), b"[1, 2]", b"null"][rng.integers(5)])


def remove(path: Path, _rng: np.random.Generator) -> None:
    path.unlink()


def swap(path: Path, rng: np.random.Generator) -> None:
    """With another file of the capture."""
    files = sorted(p for p in path.parent.rglob("*") if p.is_file())
    other = files[rng.integers(len(files))]
    mine, its = path.read_bytes(), other.read_bytes()
    path.write_bytes(its)
    other.write_bytes(mine)


def make_directory(path: Path, _rng: np.random.Generator) -> None:
    path.unlink()
    path.mkdir()


MUTATIONS: tuple[Mutation, ...] = (
    truncate, flip_bits, overwrite, overwrite, replace_word, replace_word, replace_line,
    replace_all, remove, swap, make_directory,
)  # fmt: skip


def pick(files: list[Path], rng: np.random.Generator) -> Path:
    """A file; those that are not images more often, because more can be wrong in them."""
    others = [path for path in files if path.suffix not in (".png", ".jpg")]
    chosen = others if others and rng.random() < 0.7 else files
    return chosen[rng.integers(len(chosen))]


def attempt(source: Path, options: ReadSettings) -> bool:
    """Open a capture and read all of it, as reconstruct and prepare do: each frame on its own.

    Whether a part of it was refused.
    """
    capture = open_capture(source, options)
    refused = bool(capture.skipped)
    for i in range(len(capture.frames)):
        try:
            capture.image(i)
            capture.depth(i)
        except TFLabError as error:
            assert str(error)
            refused = True
    assert np.isfinite(capture.world_T_cam).all()
    assert np.isfinite(capture.K).all()
    return refused


def main(layout: str, count: int) -> None:
    """Try ``count`` damaged copies."""
    frames = [
        Frame(f.name, f.image[::4, ::4], f.K / [[4], [4], [1]], f.world_T_cam, f.depth[::4, ::4])
        for f in room_frames()[:5]
    ]
    in_use = resource.getpagesize() * int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (in_use + MEMORY, in_use + MEMORY))
    module, failures, refused = LAYOUTS[layout], [], 0
    with tempfile.TemporaryDirectory() as folder:
        opened = module.write(Path(folder) / "whole", frames)
        for seed in range(count):
            rng = np.random.default_rng(seed)
            copy = Path(folder) / "copy"
            shutil.copytree(Path(folder) / "whole", copy)
            names = []
            for _ in range(rng.integers(1, 3)):
                files = sorted(path for path in copy.rglob("*") if path.is_file())
                if not files:
                    break  # the only one was removed
                path = pick(files, rng)
                mutation = MUTATIONS[rng.integers(len(MUTATIONS))]
                names.append(f"{mutation.__name__} {path.name}")
                mutation(path, rng)
            signal.alarm(SECONDS)
            try:
                refused += attempt(
                    copy / opened.relative_to(Path(folder) / "whole"), module.OPTIONS
                )
            except TFLabError:
                refused += 1
            except Exception:  # what this is about
                failures.append(
                    {"seed": seed, "did": names, "error": traceback.format_exc()[-900:]}
                )
            signal.alarm(0)
            shutil.rmtree(copy)
    print(json.dumps({"count": count, "refused": refused, "failures": failures}))


def _too_slow(*_: object) -> None:
    raise TimeoutError(f"more than {SECONDS} s")


if __name__ == "__main__":
    signal.signal(signal.SIGALRM, _too_slow)
    main(sys.argv[1], int(sys.argv[2]))
