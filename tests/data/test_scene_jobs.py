"""Scenes built in processes: whole or absent, each on its own."""

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pytest

from helpers.builders import build, crash, die, exhaust, fail, need_it_all
from tf_lab.data.sources.scene_jobs import Builder, build_scenes
from tf_lab.errors import TFLabError


def builders_of(root: Path, names: Sequence[str]) -> dict[Path, Builder]:
    builders = {"bad": fail, "bug": crash, "large": die, "gpu": exhaust, "all": need_it_all}
    return {root / n: builders.get(n.split("_")[0], build) for n in names}


def test_a_failing_scene_is_reported_and_the_others_are_built(tmp_path: Path) -> None:
    root = tmp_path / "scenes"
    names = ["bad_1", "good_1", "bad_2", "good_2"]
    with pytest.raises(TFLabError) as caught:
        build_scenes(builders_of(root, names), "building", workers=1)
    message = str(caught.value)
    assert message.startswith("2 of 4 scenes failed")
    for name in ("bad_1: frame-7.jpg: cannot be read", "bad_2"):
        assert name in message
    assert "good" not in message
    # the failed ones left nothing, not even a temporary directory
    assert sorted(p.name for p in root.iterdir()) == [".lock", "good_1", "good_2"]
    for name in ("good_1", "good_2"):
        assert (root / name / "first.txt").read_text() == "whole"
        assert int((root / name / "process.txt").read_text()) != os.getpid()

    # A second run, after the cause is gone, builds what is missing and keeps the rest.
    stamp = (root / "good_1" / "process.txt").read_text()
    (root / "good_1" / "mine.txt").write_text("keep me")
    again: dict[Path, Builder] = {root / n: partial(build, content="second") for n in names}
    build_scenes(again, "building", workers=1)
    content = [(root / n / "first.txt").read_text() for n in names]
    assert content == ["second", "whole", "second", "whole"]
    assert (root / "good_1" / "process.txt").read_text() == stamp
    assert (root / "good_1" / "mine.txt").exists()


def test_a_bug_in_a_builder_is_not_swallowed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a bug"):
        build_scenes(builders_of(tmp_path, ["bug", "good"]), "building", workers=1)
    assert sorted(p.name for p in tmp_path.iterdir()) == [".lock", "good"]


def test_a_process_that_dies_takes_no_other_scene_with_it(tmp_path: Path) -> None:
    names = ["good_1", "large", "good_2", "gpu", "good_3", "good_4"]
    with pytest.raises(TFLabError) as caught:
        build_scenes(builders_of(tmp_path, names), "building", workers=2)
    message = str(caught.value)
    assert message.startswith("2 of 6 scenes failed")
    assert "large: its process ran out of memory" in message
    assert "gpu: its process ran out of memory" in message
    for name in names:
        assert (tmp_path / name).is_dir() == name.startswith("good")


@pytest.mark.long
def test_what_is_too_much_for_two_at_a_time_is_done_by_one(tmp_path: Path) -> None:
    names = ["all_1", "all_2", "all_3"]
    build_scenes(builders_of(tmp_path, names), "building", workers=3)
    assert all((tmp_path / name / "first.txt").exists() for name in names)


def test_nothing_missing_starts_no_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_args: object, **_kwargs: object) -> None:
        raise AssertionError("a process was started")

    monkeypatch.setattr("tf_lab.support.tasks.ProcessPoolExecutor", forbidden)
    (tmp_path / "good").mkdir()
    build_scenes(builders_of(tmp_path, ["good"]), "building", workers=1)
    build_scenes({}, "building", workers=1)
    assert not list((tmp_path / "good").iterdir())
