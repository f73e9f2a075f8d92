"""The campaigns of docs/reliability.md with few tries; TF_LAB_TRIES=25 has as many as there."""

import os
import signal
from pathlib import Path

import pytest

from helpers.faults import Case, full_disk, stopped, watch

TRIES = int(os.environ.get("TF_LAB_TRIES", "2"))
pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


COMMANDS = ("train", "train with 2 loaders", "sweep of 2 jobs", "prepare", "evaluate", "report")
COMMANDS = (*COMMANDS, "reconstruct", "benchmark")
SIGNALS = [
    pytest.param(number, group, id=f"{number.name}{'-group' if group else ''}")
    for number, group in [
        *((signal.SIGKILL, False), (signal.SIGTERM, False), (signal.SIGTERM, True)),
        *((signal.SIGINT, False), (signal.SIGINT, True)),
    ]
]


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize(("number", "group"), SIGNALS)
def test_at_a_random_moment(
    name: str, number: signal.Signals, group: bool, cases: dict[str, Case], tmp_path: Path
) -> None:
    known = watch(cases[name], tmp_path / "undisturbed")
    counts = stopped(cases[name], known, tmp_path / "work", number, TRIES, group)
    assert counts.wrong() == 0, counts.notes


@pytest.mark.parametrize("name", ["train", "prepare", "evaluate", "report", "reconstruct"])
def test_a_full_disk(name: str, cases: dict[str, Case], tmp_path: Path) -> None:
    counts = full_disk(cases[name], tmp_path / "work", (0.1, 0.9))
    assert counts.wrong() == 0, counts.notes
