"""Source data to scenes with ground truth: parallel, restartable, one scene failing alone."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tf_lab.config.schema import PrepareConfig
from tf_lab.data.keyframes import select_keyframes
from tf_lab.data.scene import Scene
from tf_lab.data.shards import write_shards
from tf_lab.data.sources.embedded import EmbeddedSource
from tf_lab.data.sources.source import ATTRIBUTION, DataSource, open_source
from tf_lab.data.visibility import scene_visibility
from tf_lab.errors import TFLabError
from tf_lab.evaluation.pictures import compare
from tf_lab.experiments.provenance import provenance
from tf_lab.meshes.files import read_mesh
from tf_lab.support.files import check_folder, write_text
from tf_lab.support.layout import GROUNDTRUTH_MESH, picture_path
from tf_lab.support.progress import progress_bar
from tf_lab.support.words import counted


def run(config: PrepareConfig) -> None:
    """Prepare the splits, say what was skipped and why."""
    if config.shards:
        check_folder(Path(config.shards))
    source = open_source(config.data)
    prepared = source.prepare(config.splits, config.check)
    if prepared.summary:
        print(prepared.summary)
    elif not prepared.failed and not any(prepared.scenes.values()):
        print(f"nothing to prepare: no scene in splits=[{','.join(config.splits)}]")
    for name, reason in prepared.failed.items():
        print(f"  failed {name}: {reason}")
    if isinstance(source, EmbeddedSource):
        held_out = [s for s in prepared.scenes if s != "train" and prepared.scenes[s]]
        for split in held_out:
            _tell_visibility([Scene(path) for path in prepared.scenes[split].values()])
    if config.pictures:
        _draw([path for split in prepared.scenes.values() for path in split.values()])
    if config.shards:
        _write_shards(config, source)
    if failed := len(prepared.failed):
        raise TFLabError(
            f"{counted(failed, 'scene')} failed, see above; the others are ready, and the same "
            "command tries these again"
        )


def _tell_visibility(scenes: list[Scene]) -> None:
    """Whether choosing views can matter in them."""
    with progress_bar() as bar:
        found = [
            scene_visibility(scene, select_keyframes(scene.world_T_cam))
            for scene in bar.track(scenes, description="counting views")
        ]
    for scene, views in zip(scenes, found, strict=True):
        print(
            f"  {scene.name}: {len(scene)} frames, median point seen by {views.median:.0f} "
            f"keyframes, {views.share:.0%} of those whose frustum holds a point"
        )
    median, share = (float(np.mean([getattr(v, k) for v in found])) for k in ("median", "share"))
    print(f"  mean of {len(found)}: seen by {median:.0f} keyframes, {share:.0%} of candidates")


def _write_shards(config: PrepareConfig, source: DataSource) -> None:
    assert config.shards is not None
    sampler = source.sampler(config.training.chunk, config.model.near, config.model.far)
    index = write_shards(
        Path(config.shards),
        sampler,
        config.shard_chunks,
        config.seed,
        config.shard_size,
        provenance(),
        source.workers,
    )
    if (attribution := source.attribution()) is not None:
        write_text(index.parent / ATTRIBUTION, attribution)
    print(f"{index.parent}: {config.shard_chunks} chunks; train with data.urls={index.parent}")


def _draw(scenes: Sequence[Path]) -> None:
    """A picture of each scene's frames and ground truth; those that exist are kept."""
    pictures = {}
    for directory in scenes:
        scene = Scene(directory)
        name = scene.name if directory.name == scene.name else f"{scene.name}-{directory.name}"
        pictures[picture_path(directory.parents[1], name)] = scene
    with progress_bar() as bar:
        for path, scene in bar.track(pictures.items(), description="drawing"):
            if path.exists():
                continue
            try:
                mesh = read_mesh(scene.groundtruth / GROUNDTRUTH_MESH)
                chosen = np.linspace(0, len(scene) - 1, 6).astype(int)
                images = [scene.image(int(i)) for i in chosen]
            except TFLabError as error:
                print(f"warning: no picture of {scene.name}: {error}", file=sys.stderr)
                continue
            compare(mesh, None, images, path, path.stem, label="Ground truth")
    for folder in sorted({path.parent for path in pictures}):
        print(f"pictures: {folder}")
