"""What README and docs say is run or checked as it stands there."""

import re
import runpy
import shlex
from pathlib import Path

import pytest
import trimesh
from hydra import compose, initialize_config_dir

from helpers.made_up_runs import write_run
from helpers.tiny_jobs import call
from tf_lab.cli.command import conf_dir

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
COMMANDS = sorted(
    {
        command.strip()
        for page in PAGES
        for command in re.findall(r"python -m (tf_lab\.[^`\n&]+)", page.read_text())
    }
)


def test_the_notebooks_lines_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (REPOSITORY / "README.md").read_text(), re.DOTALL)
    script = tmp_path / "script.py"
    script.write_text(code)
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script))
    mesh = trimesh.load("room.ply", process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    assert len(mesh.faces) > 10_000


@pytest.mark.parametrize("command", [c for c in COMMANDS if not c.startswith("tf_lab.runs")])
def test_every_command_has_a_config_that_takes_its_words(command: str) -> None:
    module, *words = shlex.split(command)
    name = module.removeprefix("tf_lab.")
    given = [w.replace("=NAME", "=captures").split(",")[0] for w in words if not w.startswith("-")]
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        assert compose(name, [] if given == ["..."] else given)


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("tf_lab.runs")])
def test_every_command_on_runs_does_what_it_says(tmp_path: Path, command: str) -> None:
    """It has no config: on one run, it lists or shows it."""
    run = write_run(tmp_path, "views=4", seed=0, fscores=[0.5])
    _, *words = shlex.split(command.replace("NAME", run.name))
    result = call("runs", *words, f"output={tmp_path}")
    assert result.status == 0, result.err
    assert run.name in result.out
    assert "0.500" in result.out
