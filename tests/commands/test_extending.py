"""docs/extending.md, followed to the letter: its package works without a change of tf_lab."""

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

from helpers.layouts import plain, room_frames
from helpers.tiny_jobs import TINY, Result, environment

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "extending.md").read_text()
FILES = dict(re.findall(r'^```\w+ title="([^"]+)"\n(.*?)^```', PAGE, re.DOTALL | re.MULTILINE))
pytestmark = pytest.mark.long
COMMANDS = re.findall(r"^python -m (tf_lab\..+|pytest .+)$", PAGE, re.MULTILINE)


@pytest.fixture(scope="module")
def home(workshop: Path) -> Path:
    """Where the page's commands run; with pytest-xdist the workers share it."""
    return workshop / "extending"


@pytest.fixture(scope="module")
def results(home: Path, cache: Path) -> dict[str, Result]:
    """What the page's commands did, one after the other, in the package's folder."""
    kept = home.with_suffix(".json")
    with FileLock(home.with_suffix(".lock")):
        if not kept.exists():
            install(home)
            for split in ("train", "val", "test"):
                plain.write(home / "DIR" / split / "kitchen", room_frames())
                write_arrays(home / "ARRAYS" / split / "kitchen.npz")
            done = {command: asdict(run(command, home, cache)) for command in COMMANDS}
            kept.write_text(json.dumps(done))
    return {command: Result(**result) for command, result in json.loads(kept.read_text()).items()}


def run(command: str, home: Path, cache: Path) -> Result:
    """``python -m`` a command with the package installed, by settings that make it small."""
    module, *words = shlex.split(command)
    path = os.pathsep.join([str(home), *sys.path])
    done = subprocess.run(
        [sys.executable, "-m", module, *small(module, words), *words],
        cwd=home,
        env=environment(PYTHONPATH=path, TF_LAB_CACHE=str(cache)),
        capture_output=True,
        text=True,
    )
    return Result(done.returncode, done.stdout, done.stderr)


def small(module: str, words: Sequence[str]) -> list[str]:
    """Settings of a command that make it small."""
    if module != "tf_lab.train" or "--help" in words:
        return []
    rooms = ("data.size", "data.val_size", "data.test_size", "data.frames", "data.test_frames")
    own = {"data=folders", "data=arrays"}.intersection(words)
    sized = ("data.width", "data.height", "data.workers")
    left_out = (*(rooms if own else ()), *(sized if "data=arrays" in words else ()))
    return [word for word in TINY if not word.startswith(left_out)]


def write_arrays(path: Path) -> None:
    """The frames as the page's second source reads them."""
    frames = room_frames()
    path.parent.mkdir(parents=True)
    np.savez(
        path,
        images=np.stack([frame.image for frame in frames]),
        depth=np.stack([frame.depth for frame in frames if frame.depth is not None]),
        K=frames[0].K,
        world_T_cam=np.stack([frame.world_T_cam for frame in frames]),
    )


def install(root: Path) -> None:
    """Write the page's package as an installed one: modules, and beside them the entry points."""
    for name, content in FILES.items():
        (root / name).parent.mkdir(exist_ok=True, parents=True)
        (root / name).write_text(content)
    project = tomllib.loads(FILES["pyproject.toml"])["project"]
    info = root / f"{project['name']}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Name: {project['name']}\nVersion: {project['version']}\n")
    points = [f"{k} = {v}" for k, v in project["entry-points"]["tf_lab.parts"].items()]
    (info / "entry_points.txt").write_text("\n".join(["[tf_lab.parts]", *points, ""]))


def test_every_command_works(results: dict[str, Result]) -> None:
    assert len(results) >= 7
    for command, result in results.items():
        assert result.status == 0, f"{command}\n{result.err}{result.out[-2000:]}"


def test_help_names_the_parts_and_their_settings(results: dict[str, Result]) -> None:
    lines = results["tf_lab.train fusion=recurrent fusion.layers=2 --help"].out.splitlines()
    for choice in ("* fusion=recurrent", "  select=spread", "  data=folders"):
        assert any(line.startswith(choice) for line in lines), choice
    (layers,) = (line for line in lines if line.startswith("  fusion.layers=2 "))
    assert "recurrent layers" in layers


def test_settings_decide_what_is_trained(results: dict[str, Result]) -> None:
    """A policy and a metric reuse the training; a policy that is trained with, and other data, is
    another.
    """
    trained = {c: r.path("training") for c, r in results.items() if "training:" in r.out}
    first = trained["tf_lab.train fusion=recurrent"]
    assert trained["tf_lab.train fusion=recurrent select=spread"] == first
    assert trained["tf_lab.train fusion=recurrent select=spread metrics=recall2"] == first
    by_spread = "tf_lab.train fusion=recurrent select=spread +training.rules.spread=1"
    assert trained[by_spread] != first
    assert len(set(trained.values())) == 4


def test_the_metric_is_in_the_row(results: dict[str, Result], home: Path) -> None:
    result = results["tf_lab.train fusion=recurrent select=spread metrics=recall2"]
    assert "Recall 2 cm" in result.out
    metrics = json.loads((home / result.path("run") / "metrics.json").read_text())
    assert 0 <= metrics["mean"]["recall2"] <= metrics["mean"]["recall"]  # 2 cm are less than 5


def test_the_report_has_their_rows(results: dict[str, Result], home: Path) -> None:
    assert results["tf_lab.report"].status == 0
    tables = (home / "outputs" / "report" / "tables.md").read_text()
    for label in ("recurrent", "spread"):
        assert re.search(rf"^\| Ours: .*{label}", tables, re.MULTILINE), label
