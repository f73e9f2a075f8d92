"""No command reaches beyond this machine: not in the tests' process, nor as one of its own."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from helpers import network
from helpers.faults import Case, undisturbed
from helpers.tiny_jobs import environment

BEYOND = ("192.0.2.1", 80)  # of nobody: for documentation (RFC 5737)


def test_a_test_that_does_fails() -> None:
    with pytest.raises(pytest.fail.Exception, match="a look-up of"):
        socket.create_connection(BEYOND, timeout=0.1)
    with socket.socket() as one, pytest.raises(pytest.fail.Exception, match="a connection to"):
        one.connect(BEYOND)


def test_a_process_that_does_is_written_down(tmp_path: Path) -> None:
    variables = network.for_processes(tmp_path)
    code = f"import socket; socket.create_connection({BEYOND}, timeout=0.1)"
    done = subprocess.run([sys.executable, "-c", code], env=environment(**variables))
    assert done.returncode == 1
    assert (tmp_path / "reached.txt").read_text() == "-c: a look-up of 192.0.2.1\n"


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_no_command_does(
    cases: dict[str, Case], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in network.for_processes(tmp_path).items():
        monkeypatch.setenv(name, value)
    for name in ("train with 2 loaders", "prepare", "reconstruct", "evaluate", "report"):
        to = tmp_path / name
        to.mkdir()
        undisturbed(cases[name], to)
    assert not (tmp_path / "reached.txt").exists()
