"""Fitting any module: interrupted, resumed, of other settings, or from a checkpoint of old."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import lightning as L
import pytest
import torch
from lightning.pytorch.callbacks import Callback, EarlyStopping
from torch import Tensor
from torch.utils.data import DataLoader

from helpers.line import CPU, Line, Numbers
from tf_lab.config.groups import TrainerSettings
from tf_lab.errors import TFLabError
from tf_lab.experiments.provenance import sessions_of
from tf_lab.training.callbacks import TrainingSessions
from tf_lab.training.datamodule import batches_done
from tf_lab.training.fit import FitSettings, fit, rank_zero_lock


class Greedy(Line):
    """Asks for more memory than there is, as a GPU's allocator tells it."""

    def __init__(self, error: Exception) -> None:
        super().__init__()
        self.error = error

    def training_step(self, batch: Tensor, batch_idx: int) -> Tensor:
        if batch_idx == 2:
            raise self.error
        return super().training_step(batch, batch_idx)


class StopAt(Callback):
    """Ends a training as a signal does."""

    def __init__(self, step: int) -> None:
        self.step = step

    def on_train_batch_end(self, trainer: L.Trainer, *_: Any) -> None:
        if trainer.global_step == self.step:
            trainer.should_stop = True


def fitted(directory: Path, *callbacks: Callback, **others: Any) -> Line:
    line = Line()
    settings = FitSettings(steps=9, save_every=2)
    fit(line, Numbers, directory, CPU, settings, loggers=[], callbacks=callbacks, **others)
    return line


@pytest.mark.parametrize(
    "error",
    [
        torch.OutOfMemoryError(
            "CUDA out of memory. Tried to allocate 9 GiB. GPU 0 has 8 GiB. See documentation"
        ),
        RuntimeError("[enforce fail at alloc.cpp:1] DefaultCPUAllocator: can't allocate memory"),
        MemoryError(),
    ],
)
def test_too_little_memory_is_told_with_what_takes_less(tmp_path: Path, error: Exception) -> None:
    settings = FitSettings(steps=9, save_every=1, less="fewer pairs")
    with pytest.raises(TFLabError) as told:
        fit(Greedy(error), Numbers, tmp_path, CPU, settings, loggers=[])
    assert str(told.value).startswith(f"{tmp_path}: too little memory")
    assert "See documentation" not in str(told.value)
    assert "fewer pairs, trainer.precision=16-mixed" in str(told.value)
    assert (tmp_path / "last.ckpt").exists()  # of the steps before


def test_other_errors_of_a_step_stay_what_they_are(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="a bug"):
        fit(
            *(Greedy(RuntimeError("a bug")), Numbers, tmp_path, CPU),
            FitSettings(steps=9, save_every=1),
            loggers=[],
        )


def test_an_interrupted_one_goes_on_to_the_same_end(tmp_path: Path) -> None:
    whole = fitted(tmp_path / "whole")
    assert whole.seen == [float(step) for step in range(9)]
    with pytest.raises(KeyboardInterrupt):
        fitted(tmp_path / "parts", StopAt(5))
    rest = fitted(tmp_path / "parts")
    assert rest.seen == [5.0, 6.0, 7.0, 8.0]
    assert torch.equal(rest.slope, whole.slope)
    saved = torch.load(tmp_path / "parts" / "last.ckpt", weights_only=True)
    assert saved["global_step"] == 9


class StopAfter(Callback):
    """Ends a training after so many batches, in the midst of a step, as `max_time` does."""

    def __init__(self, batches: int) -> None:
        self.left = batches

    def on_train_batch_end(self, trainer: L.Trainer, *_: Any) -> None:
        self.left -= 1
        trainer.should_stop = self.left == 0


class AllNumbers(L.LightningDataModule):
    """The number of every batch."""

    def train_dataloader(self) -> DataLoader[float]:
        assert self.trainer is not None
        numbers = [float(batch) for batch in range(batches_done(self.trainer), 100)]
        return DataLoader(numbers, batch_size=None)  # type: ignore[arg-type]


def test_a_step_that_was_broken_off_is_done_as_a_whole(tmp_path: Path) -> None:
    """With accumulated gradients a training may end between the batches of a step."""
    trainer = replace(CPU, others={"accumulate_grad_batches": 2})
    settings = FitSettings(steps=6, save_every=9)
    whole = Line()
    fit(whole, AllNumbers, tmp_path / "whole", trainer, settings, loggers=[])
    assert whole.seen == [float(batch) for batch in range(12)]
    parts = Line()
    with pytest.raises(KeyboardInterrupt):
        stop = [StopAfter(5)]
        fit(Line(), AllNumbers, tmp_path / "parts", trainer, settings, loggers=[], callbacks=stop)
    fit(parts, AllNumbers, tmp_path / "parts", trainer, settings, loggers=[])
    assert parts.seen == [float(batch) for batch in range(4, 12)]
    assert torch.equal(parts.slope, whole.slope)


def test_gradients_are_clipped(tmp_path: Path) -> None:
    """Of the batches 0, 1 and 2 the gradients are 0, -4 and -15.9: steps of 0, 0.01 and 0.01."""
    line = Line()
    settings = FitSettings(steps=3, save_every=9, clip=1.0)
    fit(line, Numbers, tmp_path, CPU, settings, loggers=[])
    assert line.slope.item() == pytest.approx(0.02, abs=1e-6)


class Validated(Line):
    score = 1.0

    def validation_step(self, batch: Tensor, batch_idx: int) -> None:
        self.log("val/score", self.score, batch_size=1)


class NumbersToValidate(Numbers):
    def val_dataloader(self) -> DataLoader[float]:
        return DataLoader([0.0], batch_size=None)  # type: ignore[arg-type]


def stopped_early(directory: Path, *callbacks: Callback, **others: Any) -> tuple[Line, L.Trainer]:
    line, settings = Validated(), FitSettings(steps=90, save_every=99, validate_every=2)
    line.score = others.pop("score", 1.0)
    stops = [EarlyStopping("val/score", mode="max", patience=2), *callbacks]
    given = {"loggers": [], "callbacks": stops, **others}
    return line, fit(line, NumbersToValidate, directory, CPU, settings, **given)


def test_early_stopping_finishes_a_training(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line, made = stopped_early(tmp_path)
    assert made.global_step == 6  # the first score, and two that are no better
    assert "finished at step 6 of 90: Monitored metric val/score" in capsys.readouterr().out
    again, _ = stopped_early(tmp_path)  # as after a kill before the weights were written
    assert not again.seen and torch.equal(again.slope, line.slope)


def test_what_stopped_another_training_does_not_finish_this_one(tmp_path: Path) -> None:
    stopped_early(tmp_path / "other")
    with pytest.raises(KeyboardInterrupt):
        start = lambda: tmp_path / "other" / "last.ckpt"  # noqa: E731
        stopped_early(tmp_path / "new", StopAt(7), start=start, score=2.0)


def test_it_goes_on_from_a_state_elsewhere_only_without_one_of_its_own(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        fitted(tmp_path / "other", StopAt(7))
    elsewhere: Callable[[], Path] = lambda: tmp_path / "other" / "last.ckpt"  # noqa: E731
    assert fitted(tmp_path / "new", start=elsewhere).seen == [7.0, 8.0]
    with pytest.raises(KeyboardInterrupt):
        fitted(tmp_path / "own", StopAt(3))
    assert fitted(tmp_path / "own", start=elsewhere).seen[0] == 3


def test_a_limit_of_time_is_of_a_session_and_loses_nothing(tmp_path: Path) -> None:
    class Slow(Line):
        def training_step(self, batch: Tensor, batch_idx: int) -> Tensor:
            time.sleep(0.6)
            return super().training_step(batch, batch_idx)

    limited = replace(CPU, max_time="00:00:00:01")
    seen: list[float] = []
    for _ in range(9):
        line = Slow()
        try:
            fit(line, Numbers, tmp_path, limited, FitSettings(steps=4, save_every=9), loggers=[])
        except KeyboardInterrupt:
            seen += line.seen
        else:
            break
    assert [*seen, *line.seen] == [0.0, 1.0, 2.0, 3.0] and len(seen) >= 2


def test_validations_are_steps_apart_whatever_a_step_is_made_of(tmp_path: Path) -> None:
    at: list[int] = []

    class Validated(Line):
        def validation_step(self, batch: Tensor, batch_idx: int) -> None:
            at.append(self.trainer.global_step)

    class Both(Numbers):
        def val_dataloader(self) -> DataLoader[float]:
            return DataLoader([0.0], batch_size=None)  # type: ignore[arg-type]

    settings = FitSettings(steps=6, save_every=9, validate_every=3)
    twice = replace(CPU, others={"accumulate_grad_batches": 2})
    fit(Validated(), Both, tmp_path, twice, settings, loggers=[])
    assert at == [3, 6]


@pytest.mark.parametrize(
    ("name", "cure"),
    [("max_time", "trainer.max_time"), ("limit_train_batches", "optimizer.steps, or data.size")],
)
def test_what_a_setting_of_ours_is_for(name: str, cure: str) -> None:
    with pytest.raises(TFLabError, match=f"^trainer.others.{name}: give {cure} instead$"):
        TrainerSettings(others={name: 5})


def test_what_is_wrong_with_the_trainer_is_told_before_data_is_made(tmp_path: Path) -> None:
    def data() -> Numbers:
        raise AssertionError("data is made")

    wrong = TrainerSettings(accelerator="cpu", others={"gpus": 3})
    with pytest.raises(TFLabError, match=r"^trainer: .*gpus.*; see the files in conf/trainer$"):
        fit(Line(), data, tmp_path, wrong, FitSettings(9, 2), loggers=[])


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is one")
@pytest.mark.parametrize("name", ["gpu", "cuda"])
def test_a_gpu_that_is_not_there(name: str, tmp_path: Path) -> None:
    wrong = TrainerSettings(accelerator=name)
    with pytest.raises(
        TFLabError, match=rf"^trainer\.accelerator={name}: torch sees no CUDA GPU here; leave "
    ):
        fit(Line(), Numbers, tmp_path, wrong, FitSettings(9, 2), loggers=[])


@pytest.mark.parametrize("before", [[], ["config.yaml"]])
@pytest.mark.parametrize("result", [[], ["last.ckpt"], ["logs/version_0/metrics.csv"]])
@pytest.mark.parametrize("error", [TFLabError, KeyboardInterrupt])
def test_only_a_new_training_without_any_result_leaves_nothing_when_refused(
    tmp_path: Path, before: list[str], result: list[str], error: type[BaseException]
) -> None:
    directory = tmp_path / "trainings" / "one"

    def write(names: list[str]) -> None:
        for path in (directory / name for name in names):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()

    write(before)
    plans = ["config.yaml", "logs/version_0/hparams.yaml"]
    with pytest.raises(error), rank_zero_lock(directory, "training"):
        write([*plans, *result])
        raise error
    left = {path for path in tmp_path.rglob("*") if path.is_file() and path.name != ".lock"}
    if error is TFLabError and not before and not result:
        assert list(tmp_path.iterdir()) == []
    else:
        assert left == {directory / name for name in {*before, *plans, *result}}


def test_sessions_go_on_from_what_was_saved(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        fitted(tmp_path, TrainingSessions(), StopAt(5))
    state = torch.load(tmp_path / "last.ckpt", weights_only=True)
    (session,) = state["callbacks"]["TrainingSessions"]["sessions"]
    sessions = TrainingSessions()
    fitted(tmp_path, sessions)
    assert len(sessions.summary()["sessions"]) == 2
    assert sessions.summary()["sessions"][0] == session
    assert sessions_of({"sittings": [session]}) == sessions_of({"sessions": [session]})
    assert sessions_of({}) == []
