"""Under Slurm: nobody else's checkpoint is loaded, and there is a process for each device."""

from pathlib import Path
from typing import Any

import lightning as L
import pytest

from helpers.line import CPU, Line, Numbers
from tf_lab.errors import TFLabError
from tf_lab.training.clusters import check_processes, cluster_plugins, telling_lost_processes
from tf_lab.training.evaluation import evaluate_network
from tf_lab.training.fit import FitSettings, fit


def slurm(monkeypatch: pytest.MonkeyPatch, tasks: int, **others: str) -> None:
    """The environment of the first task of a job."""
    found = {"JOB_ID": "7", "JOB_NAME": "job", "PROCID": "0", "LOCALID": "0", "NODEID": "0"}
    for name, value in {**found, "NTASKS": str(tasks), **others}.items():
        monkeypatch.setenv(f"SLURM_{name}", value)


def trainer(devices: int, **others: Any) -> L.Trainer:
    return L.Trainer(
        accelerator="cpu", devices=devices, strategy="ddp", plugins=cluster_plugins(), **others
    )


@pytest.mark.parametrize("tasks", [1, 2])
def test_a_checkpoint_of_another_in_the_working_folder_is_not_loaded(
    tasks: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    fit(Line(), Numbers, tmp_path / "other", CPU, FitSettings(6, 100), loggers=[])
    (tmp_path / "other" / "last.ckpt").rename(tmp_path / "hpc_ckpt_1.ckpt")
    slurm(monkeypatch, tasks, NTASKS_PER_NODE=str(tasks))
    if tasks == 2:  # Lightning would wait for the other
        monkeypatch.setattr("tf_lab.training.fit.check_processes", lambda _: None)
    line = Line()
    fit(line, Numbers, tmp_path / "own", CPU, FitSettings(3, 100), loggers=[])
    assert line.seen == [0.0, 1.0, 2.0]  # from the start


def test_nor_is_it_into_what_is_tested(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Tested(Line):
        run, tell = tmp_path / "run", None

        def test_step(self, batch: Any, batch_idx: int) -> dict[str, float]:
            self.seen.append(self.slope.item())
            return {"fscore": 0.0}

    monkeypatch.chdir(tmp_path)
    fit(Tested(), Numbers, tmp_path / "other", CPU, FitSettings(6, 100), loggers=[])
    (tmp_path / "other" / "last.ckpt").rename(tmp_path / "hpc_ckpt_1.ckpt")
    slurm(monkeypatch, 1)
    module: Any = Tested()
    evaluate_network(module, [tmp_path], accelerator="cpu", devices=1)
    assert module.seen == [0.0]  # its own slope


def test_a_job_of_one_task_trains_on_all_its_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    slurm(monkeypatch, 1)
    made = trainer(2)
    assert made.world_size == 2
    check_processes(made)


def test_too_few_tasks_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    slurm(monkeypatch, 2, NTASKS_PER_NODE="2")
    check_processes(trainer(2))
    (slurm_environment,) = cluster_plugins()
    assert not slurm_environment.auto_requeue
    with pytest.raises(TFLabError, match=r"of 4 devices .* for 2; on 1 node give srun.*=4"):
        check_processes(trainer(4))


def test_tasks_that_lightning_cannot_place(monkeypatch: pytest.MonkeyPatch) -> None:
    slurm(monkeypatch, 2)
    with pytest.raises(TFLabError, match=r"Slurm: .*ntasks-per-node=2"):
        cluster_plugins()


def test_elsewhere_lightning_finds_out(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not cluster_plugins()
    slurm(monkeypatch, 2, NTASKS_PER_NODE="2")
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "none")  # torchrun, in a job of Slurm
    assert not cluster_plugins()


@pytest.mark.parametrize(
    "text",
    [
        "[/pytorch/third_party/gloo/gloo/transport/tcp/pair.cc:547] Connection closed by peer",
        "NCCL error in: ProcessGroupNCCL.cpp:1, remote process exited or there was a network error",
    ],
)
def test_a_process_that_does_not_answer_is_a_line(text: str) -> None:
    told = pytest.raises(TFLabError, match="another process of this training or test ended")
    with told, telling_lost_processes():
        raise RuntimeError(text)
    with pytest.raises(RuntimeError, match="Duplicate GPU"), telling_lost_processes():
        raise RuntimeError("NCCL error in: init.cc:1, Duplicate GPU detected")
