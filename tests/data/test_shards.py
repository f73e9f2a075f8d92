"""Writing shards: what is in them, and that they are whole or not there."""

import json
import signal
import struct
import subprocess
import sys
import tarfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from helpers.small_shards import COUNT, SEED, SETTINGS, run_here, sampler, write
from tf_lab.data import shards
from tf_lab.data.scene import Scene
from tf_lab.data.shard_set import open_shards
from tf_lab.data.shard_stream import read_records
from tf_lab.data.shards import TENSORS, write_shards
from tf_lab.errors import TFLabError


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir()}


@pytest.fixture(scope="module")
def written(box_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """16 chunks, written by a process of its own."""
    directory = tmp_path_factory.mktemp("shards")
    write_shards(directory, sampler(box_scene), COUNT, SEED, per_shard=5, workers=1)
    return directory


def test_what_is_in_a_shard(written: Path, box_scene: Path) -> None:
    """Read with tarfile and by the formats' descriptions alone."""
    assert sorted(contents(written)) == [
        *(f"chunks-00000{i}.tar" for i in range(4)),
        *("plan.json", "shards.json"),
    ]
    index = json.loads((written / "shards.json").read_text())
    assert [shard["records"] for shard in index["shards"]] == [5, 5, 5, 1]
    scene = Scene(box_scene)
    with tarfile.open(written / "chunks-000001.tar") as tar:
        members = {m.name: tar.extractfile(m).read() for m in tar}  # type: ignore[union-attr]
        assert {(m.mtime, m.uid, m.gid, m.uname, m.gname) for m in tar} == {(0, 0, 0, "", "")}
    assert {name.split(".")[0] for name in members} == {f"{i:08d}" for i in range(5, 10)}
    for number in range(5, 10):
        meta = json.loads(members[f"{number:08d}.json"])
        assert meta["scene"] == "box_room"
        assert meta["size"] == [80, 60]
        tensors = members[f"{number:08d}.safetensors"]
        length = struct.unpack("<Q", tensors[:8])[0]
        header = json.loads(tensors[8 : 8 + length])
        assert header["coarse_target"]["shape"] == [7, 7, 7]
        assert header["sdf"]["shape"] == [40]
        first, last = header["K"]["data_offsets"]
        K = np.frombuffer(tensors[8 + length :][first:last], np.float32).reshape(3, 3, 3)
        for i, frame in enumerate(meta["frames"]):
            stored = (box_scene / "color" / f"{frame}.jpg").read_bytes()
            assert members[f"{number:08d}.{i:02d}.jpg"] == stored
            np.testing.assert_allclose(K[i], scene.K[scene.frames.index(frame)], rtol=1e-6)


def test_a_record_is_what_was_drawn(written: Path, box_scene: Path) -> None:
    (shard,) = open_shards(str(written / "chunks-000002.tar")).shards
    for i, found in zip((3, 0, 4), read_records(shard, [3, 0, 4]), strict=True):
        assert found is not None
        drawn = sampler(box_scene).record(SEED, 10 + i)
        assert (found.scene, found.size) == ("box_room", drawn.size)
        assert (found.frames, found.images) == (drawn.frames, drawn.images)
        for name in TENSORS:
            a, b = (torch.nan_to_num(getattr(x, name), -7) for x in (found, drawn))
            assert a.dtype == b.dtype
            assert torch.equal(a, b), name


def test_writing_again_changes_nothing(written: Path, box_scene: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in written.iterdir()}
    write_shards(written, sampler(box_scene), COUNT, SEED, per_shard=5)
    assert before == {path: path.stat().st_mtime_ns for path in written.iterdir()}


def test_what_is_missing_is_written_again(written: Path, box_scene: Path, tmp_path: Path) -> None:
    for name, data in contents(written).items():
        if name not in ("chunks-000001.tar", "shards.json"):
            (tmp_path / name).write_bytes(data)
    write(tmp_path, sampler(box_scene))
    assert contents(tmp_path) == contents(written)
    (tmp_path / "chunks-000003.tar").unlink()  # with the index there
    write(tmp_path, sampler(box_scene))
    assert contents(tmp_path) == contents(written)


KILLED = """
import sys
from pathlib import Path
from tf_lab.data.chunk_sampler import ChunkSampler
from tf_lab.data.settings import ChunkSettings
from tf_lab.data.shards import write_shards

if __name__ == "__main__":
    settings = ChunkSettings(chunks=2, images=3, points=40, coverage=0.2)
    sampler = ChunkSampler([Path(sys.argv[1])], settings, 0.3, 5.0)
    write_shards(Path(sys.argv[2]), sampler, 400, seed=4, per_shard=100, workers=1)
"""


def test_killed_and_started_again_ends_with_equal_bytes(box_scene: Path, tmp_path: Path) -> None:
    script = tmp_path / "write.py"
    script.write_text(KILLED)
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    process = subprocess.Popen([sys.executable, script, box_scene, killed])
    while not list(killed.glob("chunks-*.tar")):
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    time.sleep(0.3)  # its worker sees that, and ends
    assert not (killed / "shards.json").exists()
    assert len(list(killed.glob("chunks-*.tar"))) < 4
    for directory in (killed, whole):
        write(directory, sampler(box_scene), 400, per_shard=100)
    assert contents(killed) == contents(whole)


def test_two_writers_at_once_do_no_harm(
    written: Path, box_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shards, "run_tasks", run_here)
    with ThreadPoolExecutor(2) as pool:
        for _ in range(2):
            pool.submit(write_shards, tmp_path, sampler(box_scene), COUNT, SEED, per_shard=5)
    assert contents(tmp_path) == contents(written)


def test_a_directory_is_for_one_set(written: Path, box_scene: Path, tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match=r"other chunks \(seed: 4\)"):
        write_shards(written, sampler(box_scene), COUNT, seed=5, per_shard=5)
    other = sampler(box_scene, replace(SETTINGS, points=41))
    with pytest.raises(TFLabError, match=r"other chunks \(settings"):
        write(written, other)
    (tmp_path / "chunks-000000.tar").write_bytes(b"")
    with pytest.raises(TFLabError, match="unknown origin"):
        write(tmp_path, sampler(box_scene))
    (tmp_path / "plan.json").write_text("{")
    with pytest.raises(TFLabError, match=r"plan\.json: damaged"):
        write(tmp_path, sampler(box_scene))


def test_nothing_to_write(box_scene: Path, tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match="must be 1 or more"):
        write_shards(tmp_path / "none", sampler(box_scene), 0)
    with pytest.raises(TFLabError, match=r"gone/scene\.json: cannot be read"):
        write_shards(tmp_path / "none", sampler(tmp_path / "gone"), 1)
    assert not (tmp_path / "none").exists()


def test_a_failed_shard_is_told(box_scene: Path, tmp_path: Path) -> None:
    many = sampler(box_scene, replace(SETTINGS, images=21))  # of 20 frames
    message = r"4 of 4 shards failed, first chunks-000000\.tar: no chunk with 21 images"
    with pytest.raises(TFLabError, match=message):
        write(tmp_path, many)
    assert sorted(contents(tmp_path)) == ["plan.json"]
