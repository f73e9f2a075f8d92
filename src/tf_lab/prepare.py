"""Source data to scenes with ground truth: parallel, restartable, one scene failing alone.

python -m tf_lab.prepare data=NAME data.root=DIR
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig

from tf_lab.cli.command import command, plain
from tf_lab.config.datasets import (
    capture_sources,
    embedded_set,
    prepare_data,
    scene_settings,
    scenes_root,
    training_sampler,
)
from tf_lab.data.captures import prepare_captures, summarise
from tf_lab.data.scene import Scene
from tf_lab.data.shards import write_shards
from tf_lab.data.visibility import scene_visibility
from tf_lab.errors import TFLabError
from tf_lab.evaluation.pictures import compare
from tf_lab.experiments.provenance import provenance
from tf_lab.meshes.files import read_mesh
from tf_lab.support.files import check_folder
from tf_lab.support.progress import progress_bar


@command("prepare", unused=("encoder", "optimizer"), goes_on=True)
def main(cfg: DictConfig) -> None:
    """Prepare the splits, say what was skipped and why."""
    config = plain(cfg)
    if config["shards"]:
        check_folder(Path(config["shards"]))
    failed = _prepare_embedded(config) if embedded_set(config) else _prepare(config)
    if config["shards"]:
        _write_shards(config)
    if failed:
        raise TFLabError(
            f"{failed} scenes failed, see above; the others are ready, and the same command tries "
            "these again"
        )


def _prepare_embedded(config: dict[str, Any]) -> int:
    """Scenes of our own, of which none can fail."""
    for split, scenes in prepare_data(config, tuple(config["splits"])).items():
        if scenes:
            print(f"{split}: {len(scenes)} {config['data']['name']} in {scenes[0].parent}")
            if split != "train":
                _tell_visibility([Scene(s) for s in scenes])
            if config["pictures"]:
                _draw({s.name: s for s in scenes}, scenes[0].parent.parent / "pictures")
    return 0


def _tell_visibility(scenes: list[Scene]) -> None:
    """Whether choosing views can matter in them."""
    with progress_bar() as bar:
        found = [
            scene_visibility(scene) for scene in bar.track(scenes, description="counting views")
        ]
    for scene, views in zip(scenes, found, strict=True):
        print(
            f"  {scene.name}: {len(scene)} frames, median point seen by {views.median:.0f} "
            f"keyframes, {views.share:.0%} of those whose frustum holds a point"
        )
    median, share = (float(np.mean([getattr(v, k) for v in found])) for k in ("median", "share"))
    print(f"  mean of {len(found)}: seen by {median:.0f} keyframes, {share:.0%} of candidates")


def _prepare(config: dict[str, Any]) -> int:
    """Captures to scenes; how many could not be prepared."""
    chosen = capture_sources(config, tuple(config["splits"]))
    sources = {name: path for split in chosen.values() for name, path in split.items()}
    settings = scene_settings(config)
    memory = round(config["data"]["memory"] * 2**30)
    root = scenes_root(config)
    prepared = prepare_captures(
        sources, root, settings, config["data"]["workers"], memory, config["check"]
    )
    print(summarise(prepared, root / settings.key))
    if config["pictures"]:
        scenes = {f"{name}-{d.name}": d for name, d in prepared.scenes.items()}
        _draw(scenes, root / settings.key / "pictures")
    return len(prepared.failed)


def _write_shards(config: dict[str, Any]) -> None:
    index = write_shards(
        Path(config["shards"]),
        training_sampler(config),
        config["shard_chunks"],
        config["seed"],
        config["shard_size"],
        provenance(),
        config["data"]["workers"],
    )
    print(f"{index.parent}: {config['shard_chunks']} chunks; train with data.urls={index.parent}")


def _draw(scenes: Mapping[str, Path], folder: Path) -> None:
    """A picture of each scene's frames and ground truth; those that exist are kept."""
    with progress_bar() as bar:
        for name, directory in bar.track(scenes.items(), description="drawing"):
            path = folder / f"{name}.png"
            if path.exists():
                continue
            scene = Scene(directory)
            mesh = read_mesh(scene.groundtruth / "mesh_gt.ply")
            chosen = np.linspace(0, len(scene) - 1, 6).astype(int)
            images = [scene.image(int(i)) for i in chosen]
            compare(mesh, None, images, path, name, label="Ground truth")
    print(f"pictures: {folder}")


if __name__ == "__main__":
    main()
