"""Numbers that go wrong end a training at once; what was good is kept, and what is bad not read."""

from collections.abc import Callable
from pathlib import Path

import lightning as L
import pytest
import torch
from lightning.pytorch.plugins import MixedPrecision
from torch import Tensor
from torch.utils.data import DataLoader

from tf_lab.config.groups import TrainerSettings
from tf_lab.errors import TFLabError
from tf_lab.network.checkpoint import load_network, save_network
from tf_lab.network.encoders.weights import read_state_dict
from tf_lab.network.network import Network
from tf_lab.training.finite import Finite
from tf_lab.training.fit import FitSettings, fit
from tf_lab.training.state import read_state

CPU = TrainerSettings(accelerator="cpu", workers=0)
NAN, INF = float("nan"), float("inf")


class Batch:
    """A number, and where it is from."""

    def __init__(self, value: float) -> None:
        self.value, self.scenes = value, ["hall", "attic"]


class Steps(L.LightningDataModule):
    """Batches 0, 1, 2, ..."""

    def train_dataloader(self) -> DataLoader[Batch]:
        assert self.trainer is not None
        batches = [Batch(float(i)) for i in range(self.trainer.global_step, 20)]
        return DataLoader(batches, batch_size=None)  # type: ignore[arg-type]


class Goes(L.LightningModule):
    """Learns, until something becomes a value at a step: the loss, its gradient, or the weight."""

    def __init__(self, what: str, value: float, at: int) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.ones(1))
        self.what, self.value, self.at = what, value, at

    def training_step(self, batch: Batch, batch_idx: int) -> dict[str, Tensor]:
        factor = self.value if batch.value == self.at else 1.0
        loss = (self.weight**2).sum()
        if self.what == "loss":
            loss = loss * factor
        elif self.what == "gradient" and factor != 1:
            loss = loss + (self.weight - self.weight.detach()).abs().sum().sqrt()  # as 0 / 0
        return {"loss": loss, "term": 2 * loss.detach()}

    def on_before_zero_grad(self, optimizer: torch.optim.Optimizer) -> None:
        if self.what == "weight" and self.global_step == self.at:
            self.weight.data.fill_(self.value)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), 0.01)


class AlwaysOverflows(Goes):
    """Its loss is fine at every step, its gradient never."""

    def training_step(self, batch: Batch, batch_idx: int) -> dict[str, Tensor]:
        return {"loss": self.weight.sum() + (self.weight - self.weight.detach()).abs().sum().sqrt()}


def train(directory: Path, what: str, value: float, at: int, steps: int = 9) -> None:
    settings = FitSettings(steps=steps, save_every=2, clip=1.0)
    fit(Goes(what, value, at), Steps, directory, CPU, settings, loggers=[])


@pytest.mark.parametrize(
    ("what", "value", "seen"),
    [("loss", NAN, "loss nan"), ("loss", INF, "term inf"), ("gradient", NAN, "gradient norm nan")],
)
def test_a_training_stops_at_the_first_such_step(
    what: str, value: float, seen: str, tmp_path: Path
) -> None:
    with pytest.raises(TFLabError) as told:
        train(tmp_path, what, value, at=5)
    message = str(told.value)
    assert message.startswith("step 6: its numbers are not finite (")  # the sixth is that of 5
    for text in (seen, "learning rate 0.01", "scenes attic, hall", f"{tmp_path / 'last.ckpt'} is"):
        assert text in message
    state = read_state(tmp_path / "last.ckpt")
    assert state["global_step"] == 4
    train(tmp_path, what, 1.0, at=-1)  # goes on from there
    assert read_state(tmp_path / "last.ckpt")["global_step"] == 9


@pytest.mark.parametrize(("at", "kept"), [(3, "last.ckpt is kept"), (1, "is no checkpoint yet")])
def test_weights_that_are_not_finite_are_not_saved(at: int, kept: str, tmp_path: Path) -> None:
    """As after a last step of too high a learning rate, whose own loss was fine."""
    with pytest.raises(TFLabError, match=rf"not finite.*{kept}"):
        train(tmp_path, "weight", INF, at, steps=at + 1)
    last = tmp_path / "last.ckpt"
    assert not last.exists() or read_state(last)["global_step"] == 2


@pytest.mark.parametrize(("steps", "told"), [(10, False), (20, True)])
def test_a_training_whose_steps_are_skipped_is_told(steps: int, told: bool, tmp_path: Path) -> None:
    """Of a gradient that overflows at every scale; at first a scale has to be found."""
    trainer = L.Trainer(
        max_steps=steps,
        accelerator="cpu",
        plugins=[MixedPrecision("16-mixed", "cpu")],
        callbacks=[Finite(tmp_path / "last.ckpt")],
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    module = AlwaysOverflows("", 1.0, -1)
    if told:
        with pytest.raises(TFLabError, match=r"^step 20: most steps were skipped, .*bf16-mixed"):
            trainer.fit(module, Steps())
    else:
        trainer.fit(module, Steps())
    assert module.weight == 1


def test_they_are_refused_wherever_weights_are_read(
    tiny_network: Callable[..., Network], tmp_path: Path
) -> None:
    network = tiny_network()
    name, weight = next(iter(network.named_parameters()))
    with torch.no_grad():
        weight[:1] = NAN
    path = tmp_path / "model.safetensors"
    save_network(network, path, {})
    for read in (load_network, read_state_dict):
        with pytest.raises(TFLabError, match=rf"model.safetensors: 1 of .* not finite.*{name}"):
            read(path)
    train(tmp_path, "loss", 1.0, at=-1)
    state = torch.load(tmp_path / "last.ckpt", weights_only=True)
    state["state_dict"]["weight"].fill_(INF)
    torch.save(state, tmp_path / "last.ckpt")
    with pytest.raises(TFLabError, match=r"last.ckpt: 1 of 1 .*delete it to start"):
        train(tmp_path, "loss", 1.0, at=-1)


def test_a_last_checkpoint_of_another_network(tmp_path: Path) -> None:
    train(tmp_path, "loss", 1.0, at=-1)
    state = torch.load(tmp_path / "last.ckpt", weights_only=True)
    state["state_dict"]["weight"] = torch.ones(2)
    torch.save(state, tmp_path / "last.ckpt")
    with pytest.raises(TFLabError, match=r"last.ckpt: of another network \(first: weight\)"):
        train(tmp_path, "loss", 1.0, at=-1)
