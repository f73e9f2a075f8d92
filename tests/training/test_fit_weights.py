"""Weights that are trained by themselves, and what their file says of them."""

import json
from pathlib import Path
from typing import Any

import lightning as L
import pytest
import torch
from safetensors import safe_open
from torch import Tensor
from torch.utils.data import DataLoader

from tf_lab.config.groups import TrainerSettings
from tf_lab.training.fit import FitSettings
from tf_lab.training.fit_weights import fit_weights

CPU = TrainerSettings(accelerator="cpu", workers=0)


class Counter(L.LightningModule):
    """Its weight is the number of steps it has had; its score is its weight."""

    def __init__(self) -> None:
        super().__init__()
        self.steps = torch.nn.Linear(1, 1, bias=False)
        torch.nn.init.zeros_(self.steps.weight)

    def training_step(self, batch: Tensor, batch_idx: int) -> Tensor:
        return -self.steps.weight.sum()

    def validation_step(self, batch: Tensor, batch_idx: int) -> None:
        self.log("val/weight", self.steps.weight.sum())

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
    fit_weights(module.steps, module, Ones, output, CPU, settings, ["val"], {})
    with safe_open(output, "pt") as file:
        assert file.get_tensor("weight").item() == steps
        assert json.loads(file.metadata()["info"])["scores"] == {"val/weight": float(steps)}
