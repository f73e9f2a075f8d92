"""docs/extending.md, followed to the letter: its package works without a change of tf_lab."""

import json
import os
import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest

from helpers.layouts import plain, room_frames
from helpers.tiny_jobs import TINY, Result, start

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "extending.md").read_text()
FILES = dict(re.findall(r'^```\w+ title="([^"]+)"\n(.*?)^```', PAGE, re.DOTALL | re.MULTILINE))
COMMANDS = re.findall(r"^python -m tf_lab\.(.+)$", PAGE, re.MULTILINE)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's package as an installed one: its modules, and beside them its entry points."""
    root = tmp_path_factory.mktemp("package")
    for name, content in FILES.items():
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_text(content)
    project = tomllib.loads(FILES["pyproject.toml"])["project"]
    info = root / f"{project['name']}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Name: {project['name']}\nVersion: {project['version']}\n")
    points = [f"{k} = {v}" for k, v in project["entry-points"]["tf_lab.parts"].items()]
    (info / "entry_points.txt").write_text("\n".join(["[tf_lab.parts]", *points, ""]))
    return root


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the commands run, with a capture for each split."""
    home = tmp_path_factory.mktemp("home")
    for split in ("train", "val", "test"):
        plain.write(home / "DIR" / split / "kitchen", room_frames())
    return home


@pytest.fixture(scope="module")
def results(package: Path, home: Path) -> dict[str, Result]:
    """What the page's commands did, one after the other."""
    path = os.pathsep.join([str(package), *sys.path])
    found = {}
    for command in COMMANDS:
        name, *words = shlex.split(command)
        tiny = [] if name != "train" or "--help" in words else TINY
        if "data=folders" in words:
            own = {"data.workers", "data.width", "data.height"}  # the others are of rooms
            tiny = [w for w in TINY if not w.startswith("data.") or w.split("=")[0] in own]
            tiny = tiny if name == "train" else [w for w in tiny if w.startswith("data.")]
        cache = str(home / "cache")
        found[command] = start(name, *tiny, *words, cwd=home, PYTHONPATH=path, TF_LAB_CACHE=cache)
    return found


def test_every_command_works(results: dict[str, Result]) -> None:
    assert len(results) >= 8
    for command, result in results.items():
        assert result.status == 0, f"{command}\n{result.err}"


def test_help_names_the_parts_and_their_settings(results: dict[str, Result]) -> None:
    lines = results["train fusion=recurrent --help"].out.splitlines()
    for choice in ("* fusion=recurrent", "  select=spread", "  data=folders"):
        assert any(line.startswith(choice) for line in lines), choice
    (layers,) = (line for line in lines if line.strip().startswith("fusion.layers="))
    assert "recurrent layers" in layers


def test_settings_decide_what_is_trained(results: dict[str, Result]) -> None:
    """A policy and a metric reuse the training; other layers and other data are other trainings."""
    trained = {c: r.path("training") for c, r in results.items() if "training:" in r.out}
    first = trained["train fusion=recurrent"]
    assert trained["train fusion=recurrent select=spread"] == first
    assert trained["train fusion=recurrent select=spread metrics=recall2"] == first
    assert len(set(trained.values())) == 3


def test_the_metric_is_in_the_row(results: dict[str, Result], home: Path) -> None:
    result = results["train fusion=recurrent select=spread metrics=recall2"]
    assert "Recall 2 cm" in result.out
    metrics = json.loads((home / result.path("run") / "metrics.json").read_text())
    assert 0 <= metrics["mean"]["recall2"] <= metrics["mean"]["recall"]  # 2 cm are less than 5


def test_the_report_has_their_rows(results: dict[str, Result], home: Path) -> None:
    assert results["report"].status == 0
    tables = (home / "outputs" / "report" / "tables.md").read_text()
    for label in ("recurrent", "spread"):
        assert re.search(rf"^\| Ours: .*{label}", tables, re.MULTILINE), label
