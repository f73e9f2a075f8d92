"""Texts as people's tools write them are read as what they say."""

import io
import json
from pathlib import Path

import numpy as np
import pytest

from tf_lab.data.readers.parsing import read_poses
from tf_lab.errors import TFLabError
from tf_lab.support.documents import read_json
from tf_lab.support.text import parse_numbers, read_lines, read_numbers, read_text

TEXT = "grün 1\n\n# nothing\n  2\n"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "a.txt"
    marks = {"utf-16-le": b"\xff\xfe", "utf-16-be": b"\xfe\xff"}
    path.write_bytes(marks.get(encoding, b"") + TEXT.encode(encoding))
    assert read_text(path, "") == TEXT
    assert read_lines(path, "") == [(1, "grün 1"), (4, "2")]
    path.write_bytes(marks.get(encoding, b"") + json.dumps({"ä": 1}).encode(encoding))
    assert read_json(path, "") == {"ä": 1}


def test_no_text(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with pytest.raises(TFLabError, match=r"a\.txt: missing; write it"):
        read_text(path, "write it")
    path.write_bytes(b"\xff\xd8\xff\xe0 a picture")
    with pytest.raises(TFLabError, match=r"a\.txt: cannot be read as text .*; write it"):
        read_text(path, "write it")
    for content in ("{", "[" * 100_000):
        path.write_text(content)
        with pytest.raises(TFLabError, match=r"a\.txt: damaged: not JSON .*; write it"):
            read_json(path, "write it")


@pytest.mark.parametrize(
    "text",
    ["1 2.5 -3e-2", "1, 2.5, -3e-2", "1;2.5;-3e-2\n", "[[1 2.5]\n [-0.03]]", "1 2.5 # two\n-.03"],
)
def test_numbers(text: str) -> None:
    assert parse_numbers(text) == [1, 2.5, -0.03]


@pytest.mark.parametrize("text", ["1 x", "1 - 2", "fx=5"])
def test_no_numbers(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(text)
    with pytest.raises(TFLabError, match=r"a\.txt: not numbers .*; write it"):
        read_numbers(path, "write it")


@pytest.mark.parametrize("delimiter", [" ", ", "])
def test_poses_as_numpy_writes_them(tmp_path: Path, delimiter: str) -> None:
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = np.random.default_rng(0).uniform(-1, 1, (3, 3))
    file = io.StringIO()
    np.savetxt(file, poses.reshape(3, 16), header="camera to world", delimiter=delimiter)
    (tmp_path / "poses.txt").write_text(file.getvalue() + "\n", encoding="utf-8-sig")
    np.testing.assert_allclose(read_poses(tmp_path / "poses.txt", ""), poses)
    with (tmp_path / "poses.txt").open("a") as more:
        more.write("1 2 3\n")
    with pytest.raises(TFLabError, match=r"poses\.txt, line 6: 3 values"):
        read_poses(tmp_path / "poses.txt", "")
