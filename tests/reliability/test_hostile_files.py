"""Damaged captures of every layout end in a clear error: no crash, no hang, no memory blow-up."""

import json
import os
import subprocess
import sys

import pytest

from helpers.layouts import LAYOUTS

COUNT = 200  # damaged copies a layout


@pytest.mark.parametrize("layout", list(LAYOUTS))
def test_damaged_captures(layout: str) -> None:
    path = os.pathsep.join(sys.path)  # the helpers' place and this tf_lab's
    done = subprocess.run(
        [sys.executable, "-m", "helpers.mutate", layout, str(COUNT)],
        env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["failures"] == []
    assert result["refused"] > COUNT / 10  # the damage is real, and much of it can be lived with
