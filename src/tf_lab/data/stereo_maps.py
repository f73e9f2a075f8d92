"""Depth maps of a scene's frames by stereo, computed once and kept in its directory.

``stereo-<key>.npy`` holds float16 [N, 2, h, w] (`tf_lab.stereo.depth`); all that shapes the maps is
in its name. Training disturbs cameras; the maps are those that cameras as wrong would have given.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

from tf_lab.data.camera_noise import disturb_cameras, share_of
from tf_lab.data.scene import Scene
from tf_lab.data.settings import CameraNoise
from tf_lab.errors import TFLabError
from tf_lab.stereo.depth import CHANNELS, SETTINGS, small_view, stereo_depth, stereo_identity
from tf_lab.stereo.sources import choose_sources
from tf_lab.support.arrays import read_array
from tf_lab.support.files import atomic_path, remove_abandoned
from tf_lab.support.hashes import hash_of
from tf_lab.support.locks import directory_lock
from tf_lab.support.tasks import run_tasks


def prepare_stereo(scenes: Sequence[Path], noise: CameraNoise, workers: int | None) -> None:
    """Write the maps that are missing, one process a scene.

    Raises:
        TFLabError: those of some scenes cannot be made (after all others were); says of one why.
    """

    def missing() -> list[Path]:
        return [scene for scene in scenes if not stereo_path(scene, noise).exists()]

    if not missing():
        return
    with contextlib.ExitStack() as locks:
        for folder in sorted({scene.parent.parent for scene in scenes}):  # of hundreds of scenes
            locks.enter_context(directory_lock(folder, "stereo depth of"))
        tasks = {str(scene): partial(write_stereo, scene, noise) for scene in missing()}
        failed = run_tasks(tasks, "stereo depth", workers) if tasks else {}
    if failed:
        first, count = next(iter(failed.values())), f"{len(failed)} of {len(tasks)} scenes"
        raise TFLabError(f"stereo depth of {count} cannot be computed; the first: {first}")


def stereo_path(scene: Path, noise: CameraNoise) -> Path:
    """Where the maps of a scene lie."""
    return scene / f"stereo-{hash_of([stereo_identity(), asdict(noise)])}.npy"


def write_stereo(directory: Path, noise: CameraNoise) -> None:
    """Compute the maps of a scene, each frame's with cameras that are wrong by a share of noise.

    Raises:
        TFLabError: an image cannot be read.
    """
    remove_abandoned(directory)
    scene, rng = Scene(directory), np.random.default_rng(0)
    views, maps = [], []
    for i in range(len(scene)):
        views.append(small_view(scene.image(i), scene.K[i], scene.world_T_cam[i], SETTINGS.width))
        poses = scene.world_T_cam[: i + 1]
        used = [i, *choose_sources(poses, i, SETTINGS.sources, SETTINGS.baseline)]
        cameras = (np.stack([views[j].K for j in used]), poses[used])
        wrong = disturb_cameras(*cameras, share_of(noise, rng.uniform()), rng)
        there = [
            views[j]._replace(K=K, world_T_cam=pose)
            for j, K, pose in zip(used, *wrong, strict=True)
        ]
        maps.append(stereo_depth(there[0], there[1:], SETTINGS).astype(np.float16))
    with atomic_path(stereo_path(directory, noise)) as temporary, temporary.open("wb") as file:
        np.save(file, np.stack(maps))


def read_stereo(scene: Scene, noise: CameraNoise) -> np.ndarray:
    """The maps of a scene, float16 [N, 2, h, w], from disk as they are needed.

    Raises:
        TFLabError: they are missing or damaged.
    """
    path = stereo_path(scene.directory, noise)
    cure = "delete it and start the training again"
    maps = read_array(path, cure)
    if maps.ndim != 4 or maps.shape[:2] != (len(scene), CHANNELS) or maps.dtype != np.float16:
        raise TFLabError(f"{path}: {maps.dtype} {list(maps.shape)} for {len(scene)} frames; {cure}")
    return maps
