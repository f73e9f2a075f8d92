"""``--help``: what a command does, its choices, and every setting with its value and meaning."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import tf_lab
from helpers.tiny_jobs import call, start
from tf_lab.config.compose import compose_config, conf_dir

COMMANDS = sorted(path.stem for path in conf_dir().glob("*.yaml"))


@pytest.mark.parametrize("command", COMMANDS)
def test_help_begins_with_purpose_and_usage(command: str) -> None:
    result = call(command, "--help")
    assert (result.status, result.err) == (0, "")
    first, blank, usage, *_ = result.out.splitlines()
    assert len(first) > 20 and first.endswith((".", ":"))
    assert blank == ""
    assert usage.startswith(f"python -m tf_lab.{command}")
    examples = re.search(r"\nExamples:\n((?:  .+\n)+)", result.out)
    assert examples is not None
    assert examples[1].count(f"  python -m tf_lab.{command}") >= 2
    assert "README.md" in result.out.splitlines()[-1]
    assert "hydra" not in result.out.lower()


def test_the_package_lists_its_commands(tmp_path: Path) -> None:
    call = [sys.executable, "-m", "tf_lab"]
    done = subprocess.run([*call, "--help"], capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    listed = re.findall(r"^  python -m tf_lab\.(\w+)  +(\w.*)$", done.stdout, re.M)
    source = [path for path in Path(tf_lab.__file__).parent.glob("[a-z]*.py")]
    assert {n for n, _ in listed} == {p.stem for p in source if '"__main__"' in p.read_text()}
    bare = subprocess.run(call, capture_output=True, text=True)
    assert (bare.returncode, bare.stdout) == (2, done.stdout)
    for word, told in [("trian", "python -m tf_lab.train"), ("foo", "no such command")]:
        wrong = subprocess.run([*call, word], capture_output=True, text=True)
        assert wrong.returncode == 2
        assert told in wrong.stderr
        assert wrong.stderr.count("\n") == 1


@pytest.mark.parametrize("command", COMMANDS)
def test_every_setting_has_a_comment(command: str) -> None:
    lines = call(command, "--help").out.partition("Settings")[2].split("\n\n")[0].splitlines()[1:]
    assert lines
    assert [line for line in lines if not re.fullmatch(r"  [\w.]+=.*?  \S.*", line)] == []


@pytest.mark.parametrize(
    "option", ["data=captures", "data=scannet", "data=flats", "logger=wandb", "model=paper"]
)
def test_every_setting_of_a_choice_has_a_comment(option: str) -> None:
    out = call("train", option, "--help").out
    assert f"* {option} " in out
    lines = out.partition("Settings")[2].split("\n\n")[0].splitlines()[1:]
    assert [line for line in lines if not re.fullmatch(r"  [\w.]+=.*?  \S.*", line)] == []


def test_every_choice_says_what_it_is() -> None:
    lines = call("train", "-h").out.partition("Choices")[2].split("\n\n")[0].splitlines()[1:]
    shown = {line[2:].split()[0] for line in lines}
    files = [p for p in conf_dir().glob("*/*.yaml") if (p.parent / p.name).is_file()]
    assert {f"{p.parent.name}={p.stem}" for p in files} <= shown
    assert [line for line in lines if not re.fullmatch(r"[* ] \S+ +\w.*\.", line)] == []
    assert sum(line.startswith("* fusion=") for line in lines) == 1


def test_the_values_are_those_of_the_command_line() -> None:
    words = ("model=small", "optimizer.steps=77", "views=4")
    out = call("train", *words, "--help").out
    config = compose_config("train", *words)
    assert re.search(r"^  optimizer.steps=77 +\w", out, re.M)
    assert re.search(r"^  views=4 +K, ", out, re.M)
    assert re.search(rf"^  model.width={config.model.width} ", out, re.M)


def test_help_of_several_jobs_is_that_of_what_they_share() -> None:
    result = call("train", "-m", "views=4,8", "select=rnd,attn", "seed=7", "--help")
    assert (result.status, result.err) == (0, "")
    assert re.search(r"^  seed=7 ", result.out, re.M)
    assert re.search(r"^  views=16 ", result.out, re.M)


@pytest.mark.parametrize("options", [("-m", "--cfg=job"), ("--run", "-m"), ("--info", "-m")])
def test_options_that_exclude_each_other(options: tuple[str, ...]) -> None:
    result = call("train", *options, "views=4,8")
    assert result.status == 2
    assert re.fullmatch(r"error: --\w+ and --\w+: one of them at a time; .*\n", result.err)


def test_a_users_own_choices(tmp_path: Path) -> None:
    """They are shown, and a wrong word beside them is told as ever."""
    own = tmp_path / "own configs" / "fusion"
    own.mkdir(parents=True)
    (own / "mine.yaml").write_text("# Mine.\ndefaults: [avg]\n")
    given = ("--config-dir", str(own.parent), "fusion=mine")
    result = call("train", *given, "--help")
    assert (result.status, result.err) == (0, "")
    assert "* fusion=mine" in result.out
    assert re.search(r"^  fusion.strategy=avg", result.out, re.M)
    result = call("train", *given, "vews=4")
    assert result.status == 2
    assert result.err.startswith(
        "error: vews: no such setting of tf_lab.train (did you mean views?)"
    )


def test_what_a_command_does_not_read_is_neither_shown_nor_taken() -> None:
    assert "optimizer." not in call("pretrain", "--help").out
    result = call("pretrain", "optimizer.steps=3")
    assert result.status == 2
    assert result.err == "error: optimizer.steps=3: tf_lab.pretrain does not use it\n"
    result = call("pretrain", "model=small", "model.width=3")  # of the model's only the encoder
    assert result.err == "error: model.width=3: tf_lab.pretrain does not use it\n"


def test_help_of_a_process(tmp_path: Path) -> None:
    result = start("evaluate", "--help", cwd=tmp_path)
    assert (result.status, result.err) == (0, "")
    assert "python -m tf_lab.evaluate predictions=DIR groundtruth=DIR" in result.out
    assert "predictions=???" in result.out
    assert list(tmp_path.iterdir()) == []


def test_what_an_input_makes_superfluous_is_told(tmp_path: Path) -> None:
    """Its images are resized to what the checkpoint was trained at, whatever data.width says."""
    for command, given in (("reconstruct", "input"), ("view", "mesh"), ("figures", "run")):
        result = call(command, f"{given}={tmp_path}", "data.width=320")
        line = f"error: data.width=320: tf_lab.{command} does not use it with {given}=\n"
        assert (result.status, result.err) == (2, line)
