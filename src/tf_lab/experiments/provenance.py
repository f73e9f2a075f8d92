"""Where a result comes from: commit and code, versions, machine, command line."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypedDict

from tf_lab import __version__


class Origin(TypedDict, total=False):
    """Where a result comes from: what `provenance` says, and what trainings and runs add to it."""

    commit: str
    code: str
    command: str
    seconds: float | None
    checkpoint: str
    scenes: dict[str, str]
    training: Origin
    init: dict[str, Any]  # of the weights that a training starts from, as their file says it
    sessions: list[Origin]
    sittings: list[Origin]  # as older versions called them


PACKAGE = Path(__file__).resolve().parents[1]
# what weights and scores depend on
CORE = ("data", "stereo", "network", "online", "meshes", "evaluation", "training", "geometry")


def provenance() -> dict[str, Any]:
    """Commit, versions, machine and command line: what is needed to repeat a run."""
    packages = ["torch", "lightning", "hydra-core", "numpy", "scipy", "scikit-image", "trimesh"]
    return {
        "tf_lab": __version__,
        "commit": commit(),
        "code": code_version(),
        "command": f"python -m tf_lab.{Path(sys.argv[0]).stem} {shlex.join(sys.argv[1:])}".strip(),
        "python": platform.python_version(),
        "packages": {name: importlib.metadata.version(name) for name in packages},
        "machine": {
            "system": platform.platform(),
            "cpus": os.cpu_count(),
            "processor": _processor(),
        },
    }


@functools.cache
def code_version() -> str:
    """A hash of the code that weights and scores depend on; a commit may change other things."""
    digest = hashlib.sha256()
    files = [path for name in CORE for path in (PACKAGE / name, *(PACKAGE / name).rglob("*.py"))]
    files += (PACKAGE / "weights").glob("*-encoder.safetensors")
    for path in sorted(path for path in files if path.is_file()):
        digest.update(f"{path.relative_to(PACKAGE).as_posix()}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


@functools.cache
def commit() -> str:
    """The checkout's commit, "-dirty" if it has changes; "unknown" outside a checkout."""
    try:
        _git("ls-files", "--error-unmatch", "__init__.py")  # else it is installed in another's
        return _git("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(*arguments: str) -> str:
    """What git says in the package's folder."""
    command = ["git", *arguments]
    done = subprocess.run(command, cwd=PACKAGE, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor()


def sessions_of(training: Origin) -> list[Origin]:
    """The times at which a training of this provenance was worked on, by which code."""
    return training.get("sessions", training.get("sittings", []))  # as older versions called them


def commits_of(origins: Iterable[Mapping[str, object]]) -> str:
    """The commits of some provenances, as people write them."""
    parts = (str(origin.get("commit", "unknown")).partition("-") for origin in origins)
    return " and ".join(dict.fromkeys(name[:9] + dash + dirty for name, dash, dirty in parts))


def without_places(value: Any, key: str = "") -> Any:
    """What a JSON file holds without absolute paths: a checkpoint's is cut, an argument's goes."""
    if isinstance(value, dict):
        return {k: without_places(v, k) for k, v in value.items()}
    if isinstance(value, list):
        return [without_places(item) for item in value]
    if key == "checkpoint" and isinstance(value, str):
        return "/".join(Path(value).parts[-3:])
    if key == "command" and isinstance(value, str):
        return _without_places(value)
    return value


def _without_places(command: str) -> str:
    """A command without the settings whose values are absolute paths."""
    try:
        words = shlex.split(command)
    except ValueError:  # of a version that did not quote them
        words = command.split()
    values = (word.partition("=")[2].lstrip("\"'[") for word in words)
    return shlex.join(
        word for word, value in zip(words, values, strict=True) if not value.startswith(("/", "~"))
    )
