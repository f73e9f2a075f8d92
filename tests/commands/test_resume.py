"""A training killed at any moment goes on, by the same command, to the same end."""

import csv
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from helpers.killed import kill_after_first_save
from helpers.tiny_jobs import TINY, Result, call, tiny_config, told
from tf_lab.commands.train import train as train_network
from tf_lab.experiments.identity import training_directory
from tf_lab.support.tables import NOTHING
from tf_lab.training.fit import AtomicSaves

STEPS = ("optimizer.steps=40", "training.save_every=5")


@pytest.fixture
def one_thread() -> Iterator[None]:
    """As the processes that tests start: sums depend on the number of threads."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.mark.usefixtures("outputs")
@pytest.mark.usefixtures("one_thread")
def test_a_killed_training_ends_with_the_weights_of_an_undisturbed_one(tmp_path: Path) -> None:
    arguments = [*TINY, *STEPS, f"output={tmp_path / 'killed'}"]
    config = tiny_config(*STEPS, f"output={tmp_path / 'killed'}")
    directory = training_directory(config)
    kill_after_first_save("train", *arguments)
    assert not (directory / "model.safetensors").exists()
    saved = torch.load(directory / "last.ckpt", weights_only=True)["global_step"]
    assert 0 < saved < 40
    listed = call("runs", f"output={tmp_path / 'killed'}").out.splitlines()
    (line,) = (line for line in listed if line.startswith(directory.name))
    commit, minutes = line.split()[-2:]
    assert commit != NOTHING and float(minutes) >= 0

    result = call("train", *arguments)
    assert result.status == 0, result.err
    assert f"resuming {directory / 'last.ckpt'}" in result.out
    assert result.path("training") == directory
    assert torch.load(directory / "last.ckpt", weights_only=True)["global_step"] == 40

    undisturbed = train_network(tiny_config(*STEPS, f"output={tmp_path / 'undisturbed'}"))
    expected = load_file(undisturbed)
    for name, value in load_file(directory / "model.safetensors").items():
        if not name.endswith("key.bias"):  # softmax cancels it: its gradient is rounding alone
            torch.testing.assert_close(value, expected[name], rtol=0, atol=1e-6, msg=name)
    with (directory / "logs" / "version_1" / "metrics.csv").open() as file:
        steps = [int(row["step"]) for row in csv.DictReader(file)]
    assert min(steps) >= saved  # it went on, and did not start again
    assert (directory / "loss.png").exists()


def test_a_kill_while_saving_leaves_the_checkpoint_before(tmp_path: Path) -> None:
    class KilledError(Exception):
        pass

    class Slow:
        """Something whose writing is cut off."""

        def __reduce__(self) -> str:
            raise KilledError

    path = tmp_path / "last.ckpt"
    AtomicSaves().save_checkpoint({"global_step": 5}, path)
    with pytest.raises(KilledError):
        AtomicSaves().save_checkpoint({"x": torch.zeros(1000), "slow": Slow()}, path)
    assert torch.load(path, weights_only=True) == {"global_step": 5}


@pytest.mark.usefixtures("outputs")
def test_what_a_kill_left_half_written_is_removed(tmp_path: Path) -> None:
    config = tiny_config(f"output={tmp_path}")
    directory = training_directory(config)
    directory.mkdir(parents=True)
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    (directory / f".partial-{socket.gethostname()}-{dead.pid}-x.ckpt").write_bytes(b"half")
    train_network(config)
    assert not list(directory.glob(".partial-*"))


@pytest.mark.usefixtures("outputs")
@pytest.mark.parametrize(
    ("state", "reason"),
    [
        (None, "damaged"),
        ([1, 2], "no state of a training, but a list"),
        ({"state_dict": {}, "global_step": 3}, "no optimizer_states in it"),
    ],
)
def test_a_last_checkpoint_that_is_none_is_named(
    state: object, reason: str, tmp_path: Path
) -> None:
    directory = training_directory(tiny_config(f"output={tmp_path}"))
    directory.mkdir(parents=True)
    last = directory / "last.ckpt"
    if state is None:
        last.write_bytes(b"damaged")
    else:
        torch.save(state, last)
    result = call("train", *TINY, f"output={tmp_path}")
    told(result, f"error: {last}: ", reason, "delete it to start this training again")


def test_damaged_weights_are_made_again_from_the_state(
    main_job: Result, outputs: Path, tmp_path: Path
) -> None:
    directory = outputs.parent / main_job.path("training")
    copy = tmp_path / "trainings" / directory.name
    shutil.copytree(directory, copy)
    weights = copy / "model.safetensors"
    expected = load_file(weights)
    whole = weights.read_bytes()
    weights.unlink()  # it is mapped into memory
    weights.write_bytes(whole[:1000])
    cure = "damaged; delete it, and the same command makes it from last.ckpt"
    told(call("train", *TINY, f"output={tmp_path}"), f"error: {weights}: {cure}")
    weights.unlink()
    again = call("train", *TINY, f"output={tmp_path}")
    assert again.status == 0 and "resuming" in again.out
    for name, value in load_file(weights).items():
        assert torch.equal(value, expected[name]), name
