"""What README and docs say is run or checked as it stands there."""

import re
import shlex
from pathlib import Path

import pytest
import trimesh
from omegaconf import DictConfig

from helpers.layouts import plain, room_frames
from helpers.made_up_runs import write_run
from helpers.tiny_jobs import call
from tf_lab.config.compose import compose_hydra

REPOSITORY = Path(__file__).resolve().parents[1]
DOCS = REPOSITORY / "docs"
OWN = {"extending.md"}  # has a test of its own
PAGES = [p for p in [*REPOSITORY.glob("*.md"), *DOCS.rglob("*.md")] if p.name not in OWN]
TEXTS = [
    *(page.read_text() for page in PAGES),
    *re.findall(
        r"\nExamples:\n([^\"]+)",
        "".join(code.read_text() for code in (REPOSITORY / "src" / "tf_lab").glob("*.py")),
    ),
]
COMMANDS = sorted(
    {
        command.strip()
        for text in TEXTS
        for command in re.findall(r"python -m (tf_lab\.[^`\n&]+)", text)
    }
)
# the settings in a page's tables, and the command that takes them
TAKEN_BY = {
    "training.md": "train",
    **dict.fromkeys(("reconstruct.md", "data.md", "own_video.md"), "reconstruct"),
}
SETTINGS = sorted(
    {
        (command, words)
        for page, command in TAKEN_BY.items()
        for row in re.findall(r"^\|.*", (DOCS / page).read_text(), re.MULTILINE)
        for words in re.findall(r"`([^`]+)`", row)
        if all(re.fullmatch(r"\+?[a-z_.]+=\S+", word) for word in words.split())
    }
)
PLACEHOLDERS = {"METRES_PER_UNIT": "0.5", "=NAME": "=captures", "=N": "=7", "=X": "=1"}


def composed(command: str, words: list[str]) -> DictConfig:
    """The config of a command as a page has it, with values in place of its placeholders."""
    for name, value in PLACEHOLDERS.items():
        words = [re.sub(rf"{name}$", value, word) for word in words]
    given = [word.split(",")[0] if "[" not in word else word for word in words]
    return compose_hydra(command, *given)


@pytest.mark.long
def test_the_lines_of_python_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / "reconstruct.md").read_text(), re.DOTALL)
    plain.write(tmp_path / "DIR", room_frames())
    monkeypatch.chdir(tmp_path)
    exec("".join(blocks), {})
    for name in ("room.ply", "mesh.ply"):
        mesh = trimesh.load(name, process=False)
        assert isinstance(mesh, trimesh.Trimesh)
        assert len(mesh.faces) > 10_000, name


@pytest.mark.parametrize("command", [c for c in COMMANDS if not c.startswith("tf_lab.runs")])
def test_every_command_has_a_config_that_takes_its_words(command: str) -> None:
    module, *words = shlex.split(command)
    given = [word for word in words if not word.startswith("-") and word != "..."]
    assert composed(module.removeprefix("tf_lab."), given)


@pytest.mark.parametrize("command", COMMANDS)
def test_no_shell_takes_a_word_for_a_pattern(command: str) -> None:
    """Zsh refuses patterns that match no file."""
    unquoted = re.sub(r"'[^']*'", "", command)
    assert not set(unquoted) & set("[]{}*?"), unquoted


@pytest.mark.usefixtures("any_launcher")
@pytest.mark.parametrize(("command", "words"), SETTINGS)
def test_every_setting_in_a_table_is_one(command: str, words: str) -> None:
    assert composed(command, words.split())


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("tf_lab.runs")])
def test_every_command_on_runs_does_what_it_says(tmp_path: Path, command: str) -> None:
    """It has no config: on one run, it lists, shows or removes it."""
    run = write_run(tmp_path, "views=4", seed=0, fscores=[0.5])
    _, *words = shlex.split(command.replace("NAME", run.name))
    result = call("runs", *words, f"output={tmp_path}")
    assert result.status == 0, result.err
    assert run.name in result.out
    assert run.exists() != ("rm" in words)
    assert ("0.500" in result.out) == run.exists()
