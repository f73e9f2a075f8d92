"""What `DataSource` promises, as checks.

Tests run every registered source through them, on a few small scenes. For one of your own::

    for check in CHECKS:
        check(settings)  # an AssertionError says what it does not keep
"""

from __future__ import annotations

from typing import Any

from tf_lab.data.scene import Scene
from tf_lab.data.sources.settings import SPLITS
from tf_lab.data.sources.source import DataSource, open_source
from tf_lab.support.layout import GROUNDTRUTH_MESH, OCCLUSION_MASK, WORLD2GRID

GROUNDTRUTH = (
    *(GROUNDTRUTH_MESH, OCCLUSION_MASK, WORLD2GRID),
    *("sdf.npy", "distance.npy", "chunks.npz"),
)


def scenes_are_whole(settings: Any) -> None:
    """Frames and ground truth, of each split that says it has scenes and of no other."""
    source = open_source(settings)
    for split in SPLITS:
        scenes = source.scenes(split)[split]
        assert bool(scenes) == source.has(split), f"has({split!r}) and scenes({split!r}) differ"
        for directory in scenes.values():
            scene = Scene(directory)
            assert len(scene) > 0 and scene.image(0).ndim == 3
            files = {path.name for path in scene.groundtruth.iterdir()}
            assert files >= {*GROUNDTRUTH}, files


def splits_share_no_scene(settings: Any) -> None:
    """Neither by place nor by name."""
    scenes = open_source(settings).scenes(*SPLITS)
    found = [item for split in SPLITS for item in scenes[split].items()]
    assert len({name for name, _ in found}) == len({place for _, place in found}) == len(found)


def preparing_again_makes_nothing(settings: Any) -> None:
    """What is there stays as it is, to the file."""
    first = open_source(settings).prepare(SPLITS).scenes
    stamps = _stamps(first)
    second = open_source(settings).prepare(SPLITS).scenes
    assert second == first
    assert _stamps(second) == stamps


def content_says_what_is_used(settings: Any) -> None:
    """The same of the same data; a run that knows it finds the same scenes, by name as well."""
    source = open_source(settings)
    content, scenes = source.content(), source.scenes("test")
    assert open_source(settings).content() == content
    assert open_source(settings).content(("test",)).test == content.test
    known: DataSource = open_source(settings, content)
    assert known.scenes("test") == scenes
    for name, directory in scenes["test"].items():
        digest = content.scenes.get("test", {}).get(name)
        assert known.directory(name, digest) == directory


def _stamps(scenes: dict[str, dict[str, Any]]) -> dict[str, int]:
    places = [place for split in scenes.values() for place in split.values()]
    files = [path for place in places for path in place.rglob("*") if path.is_file()]
    return {str(path): path.stat().st_mtime_ns for path in files}


CHECKS = (
    scenes_are_whole,
    splits_share_no_scene,
    preparing_again_makes_nothing,
    content_says_what_is_used,
)
