"""Which files a capture's scene is made of, and what of them changed."""

import os
from pathlib import Path

import pytest

from tf_lab.data import digests
from tf_lab.data.digests import find_sources, read_sources, stamps_of
from tf_lab.errors import TFLabError


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    folder = tmp_path / "kitchen"
    (folder / "images").mkdir(parents=True)
    (folder / "images" / "0.png").write_bytes(b"picture 0")
    (folder / "images" / "1.png").write_bytes(b"picture 1")
    (folder / "poses.txt").write_text("1 0 0 0")
    return folder


def touch(path: Path) -> None:
    """Another time, the same content."""
    time = path.stat().st_mtime_ns + 10**9
    os.utime(path, ns=(time, time))


def test_all_files_that_may_be_read_count(capture: Path) -> None:
    for name in (".DS_Store", "notes.md", "result.ply", "download.zip"):
        (capture / name).write_bytes(b"no source")
    (capture / "kitchen_vh_clean_2.ply").write_bytes(b"ScanNet's mesh")
    expected = {"images/0.png", "images/1.png", "poses.txt", "kitchen_vh_clean_2.ply"}
    assert set(stamps_of(capture)) == expected


def test_linked_folders_count_and_circles_end(capture: Path, tmp_path: Path) -> None:
    (capture / "images").rename(tmp_path / "elsewhere")
    (capture / "images").symlink_to(tmp_path / "elsewhere")
    (capture / "images" / "self").symlink_to(capture)
    (capture / "lost.png").symlink_to(tmp_path / "nowhere")
    assert set(stamps_of(capture)) == {"images/0.png", "images/1.png", "poses.txt"}


def test_a_file_counts_with_what_belongs_to_it(tmp_path: Path) -> None:
    belong = {"scene1.sens", "scene1_vh_clean_2.ply", "scene1.txt", "gravity-direction.txt"}
    for name in (*belong, "scene10.sens", "scene2.sens", "README.txt"):
        (tmp_path / name).write_text(name)
    assert set(stamps_of(tmp_path / "scene1.sens")) == belong


def test_files_outside_count_where_they_are_referred_to(capture: Path) -> None:
    (capture.parent / "far.png").write_bytes(b"far")
    found = find_sources(capture, ["../far.png", "../nowhere.png", "poses.txt"])
    assert set(found.stamps) == {"images/0.png", "images/1.png", "poses.txt", "../far.png"}
    assert found.digest != find_sources(capture).digest
    assert found.unchanged(capture)
    (capture.parent / "far.png").write_bytes(b"farther")
    assert not found.unchanged(capture)


def test_the_camera_of_all_replica_captures_counts(capture: Path) -> None:
    before = find_sources(capture)
    (capture.parent / "cam_params.json").write_text("{}")
    assert not before.unchanged(capture)
    assert find_sources(capture).difference(before) == "../cam_params.json added"


def test_the_digest_is_of_names_and_contents_alone(capture: Path, tmp_path: Path) -> None:
    before = find_sources(capture)
    moved = capture.rename(tmp_path / "office")
    touch(moved / "poses.txt")
    assert find_sources(moved).digest == before.digest
    (moved / "images" / "1.png").rename(moved / "images" / "2.png")
    assert find_sources(moved).digest != before.digest


def test_changes_are_noticed_and_named(capture: Path) -> None:
    before = find_sources(capture)
    assert before.unchanged(capture)
    (capture / "poses.txt").write_text("0 1 0 0")  # as long as before
    touch(capture / "poses.txt")
    assert not before.unchanged(capture)
    assert find_sources(capture, known=before).difference(before) == "poses.txt changed"
    (capture / "images" / "2.png").write_bytes(b"picture 2")
    (capture / "images" / "0.png").unlink()
    after = find_sources(capture, known=before)
    assert after.difference(before) == "poses.txt changed and 2 more"
    assert before.difference(after).startswith("poses.txt changed")


def test_only_files_of_other_size_or_time_are_read(
    capture: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = find_sources(capture)
    touch(capture / "poses.txt")
    read: list[str] = []
    original = digests._hash
    monkeypatch.setattr(digests, "_hash", lambda path: read.append(path.name) or original(path))
    assert find_sources(capture, known=known).digest == known.digest
    assert read == ["poses.txt"]


def test_what_is_noted_is_read_again(capture: Path, tmp_path: Path) -> None:
    found = find_sources(capture)
    found.write(tmp_path)
    assert read_sources(tmp_path) == found
    (tmp_path / "sources.json").write_text("{")
    assert read_sources(tmp_path) is None
    assert read_sources(tmp_path / "nowhere") is None


def test_a_file_that_cannot_be_read_is_named(
    capture: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(path: Path) -> str:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(digests, "_hash", denied)
    with pytest.raises(TFLabError, match=r"kitchen/.*: cannot be read \(Permission denied\)"):
        find_sources(capture)
