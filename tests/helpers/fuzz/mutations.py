"""Damages to files, each a function of its random numbers: bytes, texts, and what formats hold."""

import io
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

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


VALUES: list[Any] = [
    None, True, -1, 0, 1.5, 10**400, 1e308, "x", "", "../../../outside", "a\0b", [], [[]], {},
    {"a": {}}, [1e308] * 16, 1e-6, "2020-01-01", 2**63, "\ud800", 1e8, 10**8,
]  # fmt: skip
DEEP = "[" * 5000 + "]" * 5000
LEVELS = [*zip("abcdefghijk", "bcdefghijkl", strict=True)]  # each nine times the one before
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in LEVELS
)
MERGE = "a: &a {k: v}\n" + "".join(
    f"{b}: &{b} {{<<: [{', '.join([f'*{a}'] * 9)}]}}\n" for a, b in LEVELS
)
CODE = "!!python/object/apply:os.system ['touch ../outside']"
DOCUMENTS = [
    DEEP, BOMB, MERGE, CODE, "&a [*a]", "a: &a {b: *a}", "1" * 5000, "a: 1:1:1:1", "2020-01-01",
    '{"a": ' * 900 + "1" + "}" * 900, "a: !!binary aGk=",
]  # fmt: skip


def changed(document: Any, rng: np.random.Generator) -> Any:
    """A document in which something, however deep, is something else, or is lost."""
    if isinstance(document, dict | list) and document and rng.random() < 0.8:
        keys = list(document) if isinstance(document, dict) else list(range(len(document)))
        key = keys[rng.integers(len(keys))]
        copy = document.copy()
        if rng.random() < 0.15:
            del copy[key]
        elif isinstance(copy, dict) and rng.random() < 0.1:
            copy["../../outside"] = copy.pop(key)
        else:
            copy[key] = changed(copy[key], rng)
        return copy
    return VALUES[rng.integers(len(VALUES))]


def change_document(path: Path, rng: np.random.Generator) -> None:
    """Of JSON or YAML: a value is another one, or all is a document that tries a parser."""
    if rng.random() < 0.1:
        path.write_text(DOCUMENTS[rng.integers(len(DOCUMENTS))])
        return
    parse = yaml.safe_load if path.suffix == ".yaml" else json.loads
    path.write_text(json.dumps(changed(parse(path.read_text()), rng)))


def change_header(path: Path, rng: np.random.Generator) -> None:
    """Of safetensors: what the header says of the tensors, or the JSON in its texts."""
    content = path.read_bytes()
    (length,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + length])
    texts = header.get("__metadata__", {})
    if texts and rng.random() < 0.7:
        name = [*texts][rng.integers(len(texts))]
        texts[name] = json.dumps(changed(json.loads(texts[name]), rng))
        if rng.random() < 0.1:
            texts[name] = DOCUMENTS[rng.integers(len(DOCUMENTS))]
    else:
        header = changed(header, rng)
    new = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(new)) + new + content[8 + length :])


def change_arrays(path: Path, rng: np.random.Generator) -> None:
    """Of .npy and .npz: a shape, a type or the values of an array are others."""
    loaded = np.load(path)
    arrays = dict(loaded) if path.suffix == ".npz" else {"": np.array(loaded)}
    name = [*arrays][rng.integers(len(arrays))]
    array = arrays[name]
    changes: list[Callable[[], Any]] = [
        lambda: array.ravel(),
        lambda: array[:0],
        lambda: array[: len(array) // 2],
        lambda: np.full(array.shape, np.nan),
        lambda: np.full(array.shape, 1e30),
        lambda: np.zeros(array.shape, np.int8),
        lambda: array.astype(str),
        lambda: np.full(array.shape, "../../outside"),
        lambda: array.astype(complex),
        lambda: np.zeros(()),
        lambda: np.array([{"a": 1}], dtype=object),
        lambda: np.zeros(array.shape, "M8[s]"),
        lambda: array[..., None],
    ]
    arrays[name] = changes[rng.integers(len(changes))]()
    if path.suffix == ".npz" and rng.random() < 0.15:
        del arrays[name]
    with io.BytesIO() as file:
        if path.suffix == ".npz":
            np.savez(file, **arrays)
        else:
            np.save(file, arrays[name])
        path.write_bytes(file.getvalue())


SIDES = (0, 1, 13_000, 40_000, 65_535)


def resize_png(path: Path, rng: np.random.Generator) -> None:
    """A PNG that says it is of another size."""
    content = path.read_bytes()
    header = struct.pack(">II", *rng.choice(SIDES, 2)) + content[24:29]
    checksum = struct.pack(">I", zlib.crc32(b"IHDR" + header))
    path.write_bytes(content[:16] + header + checksum + content[33:])


def resize_jpeg(path: Path, rng: np.random.Generator) -> None:
    """A JPEG that says it is of another size."""
    content = path.read_bytes()
    at = content.index(b"\xff\xc0") + 5
    path.write_bytes(content[:at] + struct.pack(">HH", *rng.choice(SIDES, 2)) + content[at + 4 :])
