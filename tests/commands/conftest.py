"""Rooms, a training and a capture that all tests of the commands share.

With pytest-xdist the workers share them too: locks see to it that each is made once.
"""

import functools
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

from helpers.tiny_jobs import TINY, Result, call, start, tiny_config
from tf_lab.data.scene import Scene
from tf_lab.data.sources.source import open_source
from tf_lab.evaluation import pictures, protocol
from tf_lab.meshes import raycast
from tf_lab.support.files import atomic_directory


@pytest.fixture(scope="session")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory that all tests of this session share, those of other xdist workers included."""
    base = tmp_path_factory.getbasetemp()
    directory = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "workshop"
    directory.mkdir(exist_ok=True)
    return directory


@pytest.fixture(scope="session")
def cache(workshop: Path) -> Path:
    """Where the tiny rooms lie."""
    return workshop / "cache"


@pytest.fixture(autouse=True)
def surroundings(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test starts in an empty directory of its own: nothing may depend on the checkout.

    Pictures are small and scores are of fewer points: their own tests have them whole.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TF_LAB_CACHE", str(cache))
    monkeypatch.setenv("WANDB_SILENT", "true")
    small = functools.partial(pictures.compare, size=(96, 72))
    monkeypatch.setattr("tf_lab.evaluation.scenes.compare", small)
    monkeypatch.setattr("tf_lab.commands.reconstruct.compare", small)
    monkeypatch.setattr("tf_lab.commands.prepare.compare", small)
    monkeypatch.setattr(raycast, "AMBIENT_RAYS", 1)
    monkeypatch.setattr(raycast, "FINE", 1)
    monkeypatch.setattr(protocol, "SAMPLES", 20_000)


@pytest.fixture(scope="session")
def main_job(workshop: Path, cache: Path) -> Result:
    """The main job as a newcomer runs it: a process that renders, trains, evaluates and draws."""
    kept = workshop / "main_job.json"
    with FileLock(workshop / "main_job.lock"):
        if not kept.exists():
            done = start("train", *TINY, cwd=workshop, TF_LAB_CACHE=str(cache))
            kept.write_text(json.dumps(asdict(done)))
    return Result(**json.loads(kept.read_text()))


@pytest.fixture(scope="session")
def outputs(main_job: Result, workshop: Path) -> Path:
    """Where the shared trainings and runs lie, those of the main job first."""
    assert main_job.status == 0, main_job.err
    return workshop / "outputs"


@pytest.fixture(scope="session")
def train(outputs: Path) -> Callable[..., Result]:
    """Runs the train command on the tiny rooms; all share what it makes, unless given `output=`."""

    def run(*arguments: str) -> Result:
        flags = [argument for argument in arguments if argument.startswith("-")]  # these go first
        overrides = [argument for argument in arguments if argument not in flags]
        return call("train", *flags, *TINY, f"output={outputs}", *overrides)

    return run


@pytest.fixture(scope="session")
def checkpoint(outputs: Path, main_job: Result) -> Path:
    """The checkpoint of the main job."""
    return outputs.parent / main_job.path("training") / "model.safetensors"


@pytest.fixture(scope="session")
def rooms(outputs: Path, cache: Path) -> Callable[[str], list[Path]]:
    """The scene directories of a split of the tiny rooms. Don't write to them."""

    def find(split: str) -> list[Path]:
        return [*open_source(tiny_config(f"data.root={cache}").data).scenes(split)[split].values()]

    return find


@pytest.fixture(scope="session")
def posed_images(rooms: Callable[[str], list[Path]], workshop: Path) -> Path:
    """A test room as a user's own capture: plain layout, no depth. Don't write to it."""
    directory = workshop / "capture"
    with FileLock(workshop / "capture.lock"):
        if not directory.exists():
            with atomic_directory(directory) as temporary:
                write_plain(Scene(rooms("test")[0]), temporary)
    return directory


def write_plain(scene: Scene, directory: Path) -> None:
    """Write a scene's images, poses and intrinsics in the plain layout."""
    (directory / "images").mkdir()
    for name in scene.frames:
        shutil.copy(scene.directory / "color" / f"{name}.jpg", directory / "images")
    np.savetxt(directory / "poses.txt", scene.world_T_cam.reshape(len(scene), 16))
    np.savetxt(directory / "K.txt", scene.K[0])
    (directory / "gravity-direction.txt").write_text("0 0 -1\n")
