"""Commands run as a user types them, on tiny rooms that all these tests share.

Most run in this process, through the same entry points, because a start of Python costs seconds;
some run as processes of their own. With pytest-xdist the workers share rooms and trainings too:
the commands' own locks see to it that each is made once.
"""

import functools
import importlib
import io
import json
import logging
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filelock import FileLock
from hydra import compose, initialize_config_dir

from tf_lab import configuration, pictures
from tf_lab.commands import conf_dir, plain
from tf_lab.data.scene import Scene
from tf_lab.evaluation import protocol
from tf_lab.files import atomic_directory

# A network and rooms so small that a training takes a second.
TINY = (
    *("data.size=1", "data.val_size=1", "data.test_size=1", "data.frames=24"),
    *("data.test_frames=24", "data.width=80", "data.height=60", "data.workers=1"),
    *("model.width=8", "model.hidden=16", "model.refine_blocks=1", "model.far=2.5"),
    *("encoder.weights=none", "encoder.width=8", "encoder.blocks=[1,1,1]"),
    *("encoder.coarse_channels=8", "encoder.fine_channels=8"),
    *("training.chunks=1", "training.views=[3]", "training.points=200"),
    *("training.validate_every=0", "training.save_every=5", "optimizer.steps=5"),
    *("trainer.accelerator=cpu", "trainer.workers=0", "resolution=0.05"),
)


@dataclass(frozen=True)
class Result:
    """What a command left behind: exit status, standard output, standard error."""

    status: int
    out: str
    err: str

    def path(self, name: str) -> Path:
        """The path printed after ``name:``."""
        (line,) = (x for x in self.out.splitlines() if x.startswith(f"{name}:"))
        return Path(line.split()[1])


def call(command: str, *arguments: str) -> Result:
    """Run ``python -m tf_lab.<command> arguments`` in this process."""
    main = importlib.import_module(f"tf_lab.{command}").main
    out, err = io.StringIO(), io.StringIO()
    status = 0
    handlers = logging.root.handlers[:]
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", [f"tf_lab/{command}.py", *arguments])
        try:
            main()
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 1
        finally:
            logging.root.handlers[:] = handlers  # Hydra's would write to a closed stream
    return Result(status, out.getvalue(), err.getvalue())


def environment(**variables: str) -> dict[str, str]:
    """Of a process: one thread, so that sums are taken in the same order as here."""
    return {**os.environ, "OMP_NUM_THREADS": "1", **variables}


def start(command: str, *arguments: str, cwd: Path, **variables: str) -> Result:
    """Run ``python -m tf_lab.<command> arguments`` as a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", f"tf_lab.{command}", *arguments],
        cwd=cwd,
        env=environment(**variables),
        capture_output=True,
        text=True,
        timeout=240,
    )
    return Result(done.returncode, done.stdout, done.stderr)


@pytest.fixture(scope="session")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory that all tests of this session share, those of other xdist workers included."""
    base = tmp_path_factory.getbasetemp()
    directory = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "workshop"
    directory.mkdir(exist_ok=True)
    return directory


@pytest.fixture(scope="session", autouse=True)
def surroundings(workshop: Path) -> Iterator[None]:
    """The cache of rooms, and pictures and scores on fewer points: their own tests have them all."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TF_LAB_CACHE", str(workshop / "cache"))
        patch.setenv("WANDB_SILENT", "true")
        small = functools.partial(pictures.compare, size=(96, 72))
        patch.setattr("tf_lab.testing.compare", small)
        patch.setattr("tf_lab.reconstruct.compare", small)
        patch.setattr(protocol, "SAMPLES", 20_000)
        yield


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test starts in an empty directory of its own: nothing may depend on the checkout."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="session")
def main_job(workshop: Path, surroundings: None) -> Result:
    """The main job as a newcomer runs it: a process that renders, trains, evaluates and draws."""
    kept = workshop / "main_job.json"
    with FileLock(workshop / "main_job.lock"):
        if not kept.exists():
            done = start("train", *TINY, cwd=workshop)
            kept.write_text(json.dumps(asdict(done)))
    return Result(**json.loads(kept.read_text()))


@pytest.fixture(scope="session")
def outputs(main_job: Result, workshop: Path) -> Path:
    """Where the shared trainings and runs lie, those of the main job first."""
    assert main_job.status == 0, main_job.err
    return workshop / "outputs"


@pytest.fixture(scope="session")
def train(outputs: Path) -> Callable[..., Result]:
    """Runs the train command on the tiny rooms; what it makes is shared, unless ``output=`` is given."""

    def run(*arguments: str) -> Result:
        return call("train", *TINY, f"output={outputs}", *arguments)

    return run


@pytest.fixture(scope="session")
def checkpoint(outputs: Path, main_job: Result) -> Path:
    """The checkpoint of the main job."""
    return outputs.parent / main_job.path("training") / "model.safetensors"


@pytest.fixture(scope="session")
def rooms(main_job: Result) -> Callable[[str], list[Path]]:
    """The scene directories of a split of the tiny rooms. Don't write to them."""

    def find(split: str) -> list[Path]:
        config = tiny_config()
        return configuration.prepare_data(config, (split,))[split]

    return find


def tiny_config(*overrides: str) -> dict[str, Any]:
    """The resolved config of the train command on the tiny rooms."""
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        return plain(compose("train", overrides=[*TINY, *overrides]))


@pytest.fixture(scope="session")
def posed_images(rooms: Callable[[str], list[Path]], workshop: Path) -> Path:
    """A test room as a user's own capture, in the plain layout, without depth. Don't write to it."""
    directory = workshop / "capture"
    with FileLock(workshop / "capture.lock"):
        if not directory.exists():
            with atomic_directory(directory) as temporary:
                write_plain(Scene(rooms("test")[0]), temporary)
    return directory


def write_plain(scene: Scene, directory: Path) -> None:
    """Write a scene's images, poses and intrinsics in the plain layout."""
    (directory / "images").mkdir()
    for i, name in enumerate(scene.frames):
        shutil.copy(scene.directory / "color" / f"{name}.jpg", directory / "images")
    np.savetxt(directory / "poses.txt", scene.world_T_cam.reshape(len(scene), 16))
    np.savetxt(directory / "K.txt", scene.K[0])
    (directory / "gravity-direction.txt").write_text("0 0 -1\n")
