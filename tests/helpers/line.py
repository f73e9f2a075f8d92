"""The least that can be fitted."""

import lightning as L
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from tf_lab.config.groups import TrainerSettings

CPU = TrainerSettings(accelerator="cpu", workers=0)


class Line(L.LightningModule):
    """Learns a slope; remembers the batches that it was given."""

    def __init__(self) -> None:
        super().__init__()
        self.slope = torch.nn.Parameter(torch.zeros(1))
        self.seen: list[float] = []

    def training_step(self, batch: Tensor, batch_idx: int) -> Tensor:
        self.seen.append(float(batch))
        return (self.slope * batch - 2 * batch).square().sum()

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), 0.01)


class Numbers(L.LightningDataModule):
    """The number of every step."""

    def train_dataloader(self) -> DataLoader[float]:
        assert self.trainer is not None
        numbers = [float(step) for step in range(self.trainer.global_step, 100)]
        return DataLoader(numbers, batch_size=None)  # type: ignore[arg-type]
