"""Commands run as a user types them, with settings so small that a training takes a second.

Most run in this process, through the same entry points, because a start of Python costs seconds;
some run as processes of their own.
"""

import importlib
import io
import logging
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest

from tf_lab.commands.train import identified
from tf_lab.config.compose import compose_config
from tf_lab.config.schema import TrainConfig

# A network and rooms so small that a training takes a second.
TINY = (
    *("data.size=1", "data.val_size=1", "data.test_size=1", "data.frames=24"),
    *("data.test_frames=24", "data.width=80", "data.height=60", "data.workers=1"),
    *("model.width=8", "model.hidden=16", "model.refine_blocks=1", "model.far=2.5"),
    *("encoder.weights=none", "encoder.width=8", "encoder.blocks=[1,1,1]"),
    *("encoder.coarse_channels=8", "encoder.fine_channels=8"),
    *(
        "training.chunks=1",
        "training.images=3",
        "training.views=[2]",
        "training.coverage=0.3",
        "training.points=200",
    ),
    *("training.validate_every=0", "training.save_every=5", "optimizer.steps=5"),
    *("trainer.accelerator=cpu", "trainer.workers=0", "resolution=0.05"),
)


@dataclass(frozen=True)
class Result:
    """What a command left behind: exit status, standard output, standard error."""

    status: int
    out: str
    err: str

    def path(self, name: str) -> Path:
        """The path printed after ``name:``."""
        (line,) = (x for x in self.out.splitlines() if x.startswith(f"{name}:"))
        return Path(line.split()[1])


def call(command: str, *arguments: str) -> Result:
    """Run ``python -m tf_lab.<command> arguments`` in this process."""
    main = importlib.import_module(f"tf_lab.{command}").main
    out, err = io.StringIO(), io.StringIO()
    status = 0
    handlers = logging.root.handlers[:]
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", [f"tf_lab/{command}.py", *arguments])
        try:
            main()
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 1
        finally:
            logging.root.handlers[:] = handlers  # Hydra's would write to a closed stream
    return Result(status, out.getvalue(), err.getvalue())


def environment(**variables: str) -> dict[str, str]:
    """Of a process: one thread, so that sums are taken in the same order as here."""
    return {**os.environ, "OMP_NUM_THREADS": "1", **variables}


def start(command: str, *arguments: str, cwd: Path, **variables: str) -> Result:
    """Run ``python -m tf_lab.<command> arguments`` as a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", f"tf_lab.{command}", *arguments],
        cwd=cwd,
        env=environment(**variables),
        capture_output=True,
        text=True,
    )
    return Result(done.returncode, done.stdout, done.stderr)


def told(result: Result, *expected: str) -> None:
    """That the command failed with one line that says all of this."""
    lines = result.err.splitlines()
    assert len(lines) == 1, result.err
    assert lines[0].startswith("error: ")
    for text in expected:
        assert text in lines[0], lines[0]
    assert "Traceback" not in result.out
    assert result.status == 2


def tiny_config(*overrides: str) -> TrainConfig:
    """The config of the train command on the tiny rooms, with what is in its data."""
    return identified(compose_config("train", *TINY, *overrides))
