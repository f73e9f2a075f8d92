"""Half-written files and directories never take the place of whole ones."""

import json
import os
import threading
from pathlib import Path

import pytest
from safetensors import SafetensorError

from tf_lab.errors import TFLabError
from tf_lab.support.files import (
    atomic_directory,
    atomic_path,
    check_file,
    remove_directory,
    write_json,
)


class CutError(Exception):
    """The writer is interrupted."""


def names(directory: Path) -> list[str]:
    return [path.name for path in directory.iterdir()]


def test_path_appears_only_when_the_block_ends(tmp_path: Path) -> None:
    target = tmp_path / "new" / "mesh.ply"
    with atomic_path(target) as temporary:
        assert temporary.suffix == ".ply"
        temporary.write_text("whole")
        assert not target.exists()
    assert target.read_text() == "whole"
    assert names(target.parent) == ["mesh.ply"]
    assert target.stat().st_mode & 0o777 == 0o644


def test_what_a_link_leads_to_is_replaced(tmp_path: Path) -> None:
    target, link = tmp_path / "far" / "scores.json", tmp_path / "link.json"
    target.parent.mkdir()
    link.symlink_to(target)
    write_json(link, [1])
    assert link.is_symlink()
    assert json.loads(target.read_text()) == [1]


def test_devices_and_pipes_are_no_files_to_replace(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/null")):
        with pytest.raises(TFLabError, match="is a device or pipe; give the name of a file"):
            check_file(path)
    check_file(tmp_path / "new" / "file.json")


def test_a_full_disk_as_rust_tells_it(tmp_path: Path) -> None:
    """Its error has no number but in its text, and what was half written is gone by then."""
    with (
        pytest.raises(TFLabError, match="there is no space for it"),
        atomic_path(tmp_path / "weights") as temporary,
    ):
        raise SafetensorError("I/O error: No space left on device (os error 28)")
    with pytest.raises(SafetensorError), atomic_path(tmp_path / "weights") as temporary:
        temporary.write_text("half")
        raise SafetensorError("I/O error: something else (os error 5)")


def test_an_error_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(CutError), atomic_path(tmp_path / "mesh.ply") as temporary:
        temporary.write_text("half")
        raise CutError
    assert names(tmp_path) == []


def test_an_error_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "metrics.json"
    target.write_text("old")
    with pytest.raises(CutError), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise CutError
    assert target.read_text() == "old"
    assert names(tmp_path) == ["metrics.json"]


def test_a_writer_that_leaves_no_file_is_an_error(tmp_path: Path) -> None:
    target = tmp_path / "metrics.json"
    with pytest.raises(FileNotFoundError), atomic_path(target) as temporary:
        temporary.unlink()
    assert names(tmp_path) == []


def test_directory_appears_only_when_the_block_ends(tmp_path: Path) -> None:
    target = tmp_path / "scenes" / "room0"
    with atomic_directory(target) as temporary:
        (temporary / "scene.json").write_text("{}")
        assert not target.exists()
    assert names(target) == ["scene.json"]
    assert names(target.parent) == ["room0"]
    assert target.stat().st_mode & 0o777 == 0o755


def test_an_error_leaves_no_directory(tmp_path: Path) -> None:
    with pytest.raises(CutError), atomic_directory(tmp_path / "room0") as temporary:
        (temporary / "scene.json").write_text("{}")
        raise CutError
    assert names(tmp_path) == []


def test_of_two_writers_the_faster_stays(tmp_path: Path) -> None:
    target = tmp_path / "room0"
    both_write = threading.Barrier(2, timeout=10)

    def write(name: str) -> None:
        with atomic_directory(target) as temporary:
            (temporary / "part1").write_text(name)
            both_write.wait()
            (temporary / "part2").write_text(name)

    writers = [threading.Thread(target=write, args=(name,)) for name in ("first", "second")]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(timeout=10)
    parts = {(target / part).read_text() for part in ("part1", "part2")}
    assert parts in ({"first"}, {"second"})  # one writer's work, whole
    assert names(tmp_path) == ["room0"]


def test_a_file_in_the_directorys_place_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "room0").write_text("a file")
    with pytest.raises(OSError), atomic_directory(tmp_path / "room0") as temporary:
        (temporary / "scene.json").write_text("{}")
    assert (tmp_path / "room0").read_text() == "a file"
    assert names(tmp_path) == ["room0"]


def test_write_json_that_fails_keeps_the_old(tmp_path: Path) -> None:
    target = tmp_path / "metrics.json"
    write_json(target, {"fscore": 0.5})
    with pytest.raises(TypeError):
        write_json(target, {"fscore": object()})
    assert json.loads(target.read_text()) == {"fscore": 0.5}


def test_a_removed_directory_is_gone_at_once(tmp_path: Path) -> None:
    (tmp_path / "run" / "meshes").mkdir(parents=True)
    (tmp_path / "run" / "metrics.json").write_text("{}")
    remove_directory(tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_a_linked_directory_goes_with_its_link(tmp_path: Path) -> None:
    far, link = tmp_path / "far" / "training", tmp_path / "trainings" / "training"
    for path in (far, link.parent):
        path.mkdir(parents=True)
    (far / "weights").write_text("many")
    link.symlink_to(far)
    remove_directory(link)
    assert names(link.parent) == names(far.parent) == []
