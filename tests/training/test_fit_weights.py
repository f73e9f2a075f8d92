"""Weights that are trained by themselves, and what their file says of them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import lightning as L
import pytest
import torch
from safetensors import safe_open
from torch import Tensor
from torch.utils.data import DataLoader

from helpers.line import CPU
from tf_lab.errors import TFLabError
from tf_lab.training.fit import FitSettings
from tf_lab.training.fit_weights import fit_weights


class Counter(L.LightningModule):
    """Its weight is the number of steps it has had; its score is its weight."""

    def __init__(self) -> None:
        super().__init__()
        self.steps = torch.nn.Linear(1, 1, bias=False)
        torch.nn.init.zeros_(self.steps.weight)
        self.trained = 0
        self.sets = ["val"]

    def training_step(self, batch: Tensor, batch_idx: int) -> Tensor:
        self.trained += 1
        return -self.steps.weight.sum()

    def validation_step(self, batch: Tensor, batch_idx: int) -> None:
        for name in self.sets:
            self.log(f"{name}/weight", self.steps.weight.sum())

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), 1.0)


class Ones(L.LightningDataModule):
    """Of as many steps as are wanted, and one to validate on."""

    def train_dataloader(self) -> DataLoader[Any]:
        return DataLoader(torch.ones(100))  # type: ignore[arg-type]

    def val_dataloader(self) -> DataLoader[Any]:
        return DataLoader(torch.ones(1))  # type: ignore[arg-type]


@pytest.mark.parametrize(("steps", "every"), [(5, 2), (4, 2), (3, 50)])
def test_the_scores_in_a_file_are_of_its_weights(tmp_path: Path, steps: int, every: int) -> None:
    module, output = Counter(), tmp_path / "weights.safetensors"
    settings = FitSettings(steps, every, 10)
    fit_weights(module.steps, module, Ones, output, CPU, settings, "one", ["val"], {})
    with safe_open(output, "pt") as file:
        assert file.get_tensor("weight").item() == steps
        assert json.loads(file.metadata()["info"])["scores"] == {"val/weight": float(steps)}


def test_what_is_there_is_reused_or_stays(tmp_path: Path) -> None:
    output, settings = tmp_path / "weights", FitSettings(2, 1, 10)

    def made(identity: str, steps: int) -> Counter:
        module, longer = Counter(), replace(settings, steps=steps)
        fit_weights(module.steps, module, Ones, output, CPU, longer, identity, ["val"], {})
        return module

    made("one", 2)
    before = output.read_bytes()
    assert made("one", 2).steps.weight.item() == 0  # nothing is trained
    with pytest.raises(TFLabError, match=r"of other settings or data; give another output=, or"):
        made("other", 3)
    assert output.read_bytes() == before


def test_a_file_is_scored_on_what_it_was_made_without(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, settings = tmp_path / "weights.safetensors", FitSettings(2, 1, 10)
    for sets in (["val"], ["val", "real"]):
        module = Counter()
        module.sets = sets
        fit_weights(module.steps, module, Ones, output, CPU, settings, "one", sets, {})
    assert capsys.readouterr().out.endswith("{'val/weight': 2.0, 'real/weight': 2.0}\n")


def test_what_another_made_meanwhile_stays(tmp_path: Path) -> None:
    output = tmp_path / "weights.safetensors"

    class Late(Counter):
        def on_train_end(self) -> None:
            output.write_bytes(b"another's")

    module = Late()
    with pytest.raises(TFLabError, match="there already, and no such weights"):
        fit_weights(module.steps, module, Ones, output, CPU, FitSettings(2, 1), "one", ["val"], {})
    assert output.read_bytes() == b"another's"
    output.unlink()
    again = Counter()
    fit_weights(again.steps, again, Ones, output, CPU, FitSettings(2, 1), "one", ["val"], {})
    assert output.exists() and again.trained == 0


def test_an_unfinished_state_is_kept_beside_another_training(tmp_path: Path) -> None:
    class Stopped(Counter):
        def training_step(self, batch: Tensor, batch_idx: int) -> Tensor:
            self.trainer.should_stop = self.trainer.global_step == 3
            return super().training_step(batch, batch_idx)

    output = tmp_path / "weights.safetensors"
    first, other, again = Stopped(), Counter(), Counter()
    with pytest.raises(KeyboardInterrupt):
        first_settings = FitSettings(9, 1)
        fit_weights(first.steps, first, Ones, output, CPU, first_settings, "one", ["val"], {})
    fit_weights(other.steps, other, Ones, output, CPU, FitSettings(2, 1), "two", ["val"], {})
    output.rename(tmp_path / "two.safetensors")
    fit_weights(again.steps, again, Ones, output, CPU, FitSettings(9, 1), "one", ["val"], {})
    assert again.steps.weight.item() == 9
    assert again.trained < 9
