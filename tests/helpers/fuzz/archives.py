"""Damages to shards: tar files whose members, names, links and sizes are others."""

import gzip
import io
import json
import tarfile
import tempfile
from pathlib import Path

import numpy as np

from helpers.fuzz.mutations import change_header, changed
from tf_lab.data import shards

KINDS = 8
HARMLESS = (3, 4)  # files elsewhere, which nobody asks for


def change_tar(path: Path, rng: np.random.Generator, how: int | None = None) -> None:
    """A shard with a strange member or other content, of which checksum and index say so.

    ``how`` is one of the `KINDS`, by chance if it is not given.
    """
    with tarfile.open(path) as tar:
        members = {m.name: tar.extractfile(m).read() for m in tar if m.isfile()}  # type: ignore[union-attr]
    first = min(members).split(".")[0]
    how = int(rng.integers(KINDS)) if how is None else how
    if how == 0:
        _change_chunk(members, first, rng)
    strange = {
        1: _link("../../outside", tarfile.SYMTYPE, "/etc/passwd"),
        2: _link(f"{first}.01.jpg", tarfile.LNKTYPE, "../../outside"),
        3: _file("../../outside"),
        4: _file("/outside"),
        5: _sparse(f"{first}.02.jpg"),
    }.get(how, b"")
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as tar:
        for name, content in members.items():
            tar.addfile(_header(name, len(content)), io.BytesIO(content))
    whole = strange + out.getvalue()
    if how == 6:  # a giant size
        whole = _header(f"{first}.json", 2**40).tobuf(tarfile.GNU_FORMAT) + whole
    if how == 7:
        whole = gzip.compress(whole + bytes(2**24))
    path.write_bytes(whole)
    index = path.parent / shards.INDEX
    found = json.loads(index.read_text())
    for entry in found["shards"]:
        if entry["name"] == path.name:
            entry["bytes"] = len(whole)
    index.write_text(json.dumps(found))


def _change_chunk(members: dict[str, bytes], first: str, rng: np.random.Generator) -> None:
    with tempfile.TemporaryDirectory() as folder:
        tensors = Path(folder) / "x.safetensors"
        tensors.write_bytes(members[f"{first}.safetensors"])
        if rng.random() < 0.6:
            change_header(tensors, rng)
        members[f"{first}.safetensors"] = tensors.read_bytes()
    meta = json.loads(members[f"{first}.json"])
    rest = {k.partition(".")[2]: v for k, v in members.items() if k.startswith(f"{first}.")}
    rest.pop("json")
    meta = changed(meta, rng)
    if isinstance(meta, dict):
        meta["crc32"] = shards._checksum(rest)
    members[f"{first}.json"] = json.dumps(meta).encode()


def _header(
    name: str, size: int, kind: bytes = tarfile.REGTYPE, target: str = ""
) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.size, info.type, info.linkname = size, kind, target
    return info


def _link(name: str, kind: bytes, target: str) -> bytes:
    return _header(name, 0, kind, target).tobuf(tarfile.GNU_FORMAT)


def _file(name: str) -> bytes:
    return _header(name, 512).tobuf(tarfile.GNU_FORMAT) + bytes(512)


def _sparse(name: str) -> bytes:
    """A file of 1 TiB that takes 512 bytes: a hole, and a block at its end (PAX 1.0)."""
    real = str(2**40)
    records = {"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.name": name}
    records["GNU.sparse.realsize"] = real
    info = _header(name, 1024)
    info.pax_headers = records
    sparse_map = f"1\n{2**40 - 512}\n512\n".encode().ljust(512, b"\0")
    return info.tobuf(tarfile.PAX_FORMAT) + sparse_map + bytes(512)
