"""Which code made a result: known by its content, as far as results depend on it."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from tf_lab.experiments import provenance


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the package, to change."""
    copy = tmp_path / "tf_lab"
    shutil.copytree(provenance.PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(provenance, "PACKAGE", copy)
    return copy


def version() -> str:
    return provenance.code_version.__wrapped__()


def test_the_same_code_has_the_same_version_anywhere(package: Path) -> None:
    assert version() == provenance.code_version()


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        *(("training/losses.py", True), ("data/rooms/walk.py", True), ("meshes/files.py", True)),
        *(
            ("evaluation/metrics.py", True),
            ("stereo/cost.py", True),
            ("weights/tiny-encoder.safetensors", True),
        ),
        *(("report.py", False), ("reporting/tables.py", False), ("weights/tiny.json", False)),
    ],
)
def test_only_what_results_depend_on_counts(package: Path, name: str, counts: bool) -> None:
    before = version()
    with (package / name).open("ab") as file:
        file.write(b"\n")
    assert (version() != before) == counts


def test_what_counts_is_there() -> None:
    assert [name for name in provenance.CORE if not (provenance.PACKAGE / name).exists()] == []


def test_a_command_can_be_pasted(monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["training.rules={attention:2,random:1}", "row=a b", "init=/my data/x", "runs=[/a,/b]"]
    monkeypatch.setattr("sys.argv", ["/any/train.py", *words])
    record = provenance.provenance()
    assert shlex.split(record["command"]) == ["python", "-m", "tf_lab.train", *words]
    kept = provenance.without_places(record)["command"]
    assert shlex.split(kept) == ["python", "-m", "tf_lab.train", *words[:2]]


def test_the_record_names_commit_and_code() -> None:
    record = provenance.provenance()
    assert record["code"] == provenance.code_version()
    assert record["commit"] == provenance.commit()


def test_of_another_repository_no_commit_is_told(package: Path) -> None:
    """Where tf_lab is installed within it."""
    git = ["git", "-c", "user.name=a", "-c", "user.email=b", "-C", str(package.parent)]
    subprocess.run(["git", "init", "-q", package.parent], check=True)
    subprocess.run([*git, "commit", "-q", "--allow-empty", "-m", "theirs"], check=True)
    assert provenance.commit.__wrapped__() == "unknown"
    subprocess.run([*git, "add", "tf_lab/__init__.py"], check=True)
    subprocess.run([*git, "commit", "-q", "-m", "ours"], check=True)
    assert re.fullmatch(r"[0-9a-f]{40}", provenance.commit.__wrapped__())
