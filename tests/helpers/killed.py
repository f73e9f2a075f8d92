"""Trainings that are killed at a moment that is known."""

import signal
import subprocess
import sys

from helpers.tiny_jobs import environment

KILLED = """
import os, signal
from tf_lab.training.fit import AtomicSaves
save = AtomicSaves.save_checkpoint
def save_and_die(*arguments, **others):
    save(*arguments, **others)
    os.kill(os.getpid(), signal.SIGKILL)
AtomicSaves.save_checkpoint = save_and_die
from tf_lab.{command} import main
main()
"""


def kill_after_first_save(command: str, *arguments: str) -> None:
    """Start a training that gets SIGKILL as soon as it has a checkpoint to resume from."""
    code = KILLED.format(command=command)
    killed = subprocess.run(
        [sys.executable, "-c", code, *arguments], env=environment(), capture_output=True
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr
