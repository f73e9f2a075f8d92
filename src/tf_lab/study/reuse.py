"""What is there already, and whether another code made it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tf_lab.checkpoint import read_info
from tf_lab.errors import TFLabError
from tf_lab.provenance import code_version, commit

Origin = Mapping[str, Any]


def origin_of(directory: Path) -> Origin:
    """The provenance of a finished training, or of an evaluation and (``training``) its training.

    Raises:
        TFLabError: it is missing or damaged.
    """
    checkpoint, run = directory / "model.safetensors", directory / "run.json"
    if checkpoint.exists():
        return read_info(checkpoint).get("training", {})
    try:
        return json.loads(run.read_text())
    except (OSError, ValueError) as error:
        raise TFLabError(
            f"{run}: damaged ({error}); to make it anew: {removal(directory)}"
        ) from error


def removal(directory: Path) -> str:
    """The command that removes a training or an evaluation, so that it is made anew."""
    return f"python -m tf_lab.runs rm {shlex.quote(str(directory))}"


def say_reused(what: str, directory: Path) -> None:
    """Print that a finished training or evaluation is reused, and whether another code made it."""
    print(f"reusing the identical finished {what} {directory}", flush=True)
    try:
        origin = origin_of(directory)
    except TFLabError:
        origin = {}
    training = origin.get("training", origin)
    makers = [origin, *training.get("sittings", [])]
    if any(maker.get("code") != code_version() for maker in makers):
        now = commits_of([{"commit": commit()}])
        print(
            f"note: another code made it (commit {commits_of(makers)}, now {now}); "
            f"to make it anew: {removal(directory)}"
        )


def commits_of(origins: Iterable[Origin]) -> str:
    """The commits of some provenances, as people write them."""
    parts = (str(origin.get("commit", "unknown")).partition("-") for origin in origins)
    return " and ".join(dict.fromkeys(name[:9] + dash + dirty for name, dash, dirty in parts))
