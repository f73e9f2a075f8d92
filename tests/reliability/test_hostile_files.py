"""Damaged and hostile files of every kind end in a clear error: see `helpers.fuzz`.

No crash, no hang, no more memory than there should be, nothing written outside, no code run.
"""

import json
import os
import subprocess
import sys

import pytest

from helpers.fuzz.campaign import SECONDS, campaign
from helpers.fuzz.kinds import KINDS

SLOW_TO_READ = ("runs", "evaluation", "video")  # half a second or more each


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in SLOW_TO_READ])
def test_some_damaged_files(kind: str) -> None:
    found = campaign(kind, count=4)
    assert found["failures"] == []


@pytest.mark.slow
@pytest.mark.timeout(36_000)
@pytest.mark.parametrize("kind", KINDS)
def test_many_damaged_files(kind: str, pytestconfig: pytest.Config) -> None:
    count = pytestconfig.getoption("--mutations")
    done = subprocess.run(
        [sys.executable, "-m", "helpers.fuzz", kind, str(count)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["failures"] == []
    assert found["slowest"] < SECONDS
    assert found["refused"] > count / 10  # the damage is real; much of it can be lived with
