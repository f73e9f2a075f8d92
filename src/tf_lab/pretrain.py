"""Pre-train the encoder on the train split: the offline stand-in for ImageNet weights.

python -m tf_lab.pretrain model=tiny [output=FILE.safetensors]
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import lightning as L
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from omegaconf import DictConfig
from safetensors.torch import save_file
from torch import Tensor
from torch.utils.data import DataLoader

from tf_lab.commands import command, plain
from tf_lab.data.pairs import PairBatch, PairSettings, PairStream
from tf_lab.datasets import prepare_data
from tf_lab.files import atomic_path
from tf_lab.network.encoder import Encoder, normalise_images
from tf_lab.network.matching import matching_loss
from tf_lab.provenance import provenance
from tf_lab.study.runs import portable
from tf_lab.training import TrainingProgress


class Matching(L.LightningModule):
    """Trains an encoder so that both its maps tell corresponding pixels from others."""

    def __init__(self, encoder: Encoder, lr: float, steps: int, temperature: float) -> None:
        super().__init__()
        self.encoder, self.lr, self.steps = encoder, lr, steps
        self.temperature = temperature

    def _losses(self, batch: PairBatch) -> dict[str, Tensor]:
        size = (batch.images.shape[-1], batch.images.shape[-2])
        images = normalise_images(batch.images.flatten(0, 1))
        maps = self.encoder(images.contiguous(memory_format=torch.channels_last))
        terms: dict[str, Tensor] = {}
        for name, level in zip(("coarse", "fine"), maps, strict=True):
            pairs = level.unflatten(0, (-1, 2))
            terms[name], terms[f"{name}_top1"] = matching_loss(
                pairs, batch.uv_a, batch.uv_b, size, self.temperature
            )
        terms["loss"] = terms["coarse"] + terms["fine"]
        return terms

    def training_step(self, batch: PairBatch, batch_idx: int) -> Tensor:
        """InfoNCE at both levels."""
        terms = self._losses(batch)
        self.log_dict({f"train/{k}": v.detach() for k, v in terms.items()})
        return terms["loss"]

    def validation_step(self, batch: PairBatch, batch_idx: int) -> None:
        """The same on rooms never trained on; the best match of P + E candidates."""
        terms = self._losses(batch)
        self.log_dict({f"val/{k}": v for k, v in terms.items()}, batch_size=1)

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Adam, short warm-up, cosine to zero."""
        adam = torch.optim.Adam(self.encoder.parameters(), self.lr)

        def factor(step: int) -> float:
            return min(1, (step + 1) / 50) * 0.5 * (1 + math.cos(math.pi * step / self.steps))

        schedule = torch.optim.lr_scheduler.LambdaLR(adam, factor)
        return {"optimizer": adam, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


@command(
    "pretrain",
    unused=(
        *("model", "training", "optimizer", "encoder.weights"),
        *("trainer.devices", "trainer.strategy", "trainer.compile"),
    ),
)
def main(cfg: DictConfig) -> None:
    """Pre-train, validate on the val split, write the encoder with its provenance."""
    config = plain(cfg)
    output, origin = Path(config["output"]), provenance()
    L.seed_everything(config["seed"], verbose=False)
    splits = prepare_data(config, ("train", "val"))
    encoder = Encoder(**{k: v for k, v in config["encoder"].items() if k != "weights"})
    module = Matching(encoder, config["lr"], config["steps"], config["temperature"])
    directory = output.with_suffix("")
    settings = PairSettings(config["pairs"], config["points"], config["epipolar"])
    saving = ModelCheckpoint(
        directory,
        filename="last",
        every_n_train_steps=500,
        enable_version_counter=False,
        save_on_train_epoch_end=False,
    )
    t = config["trainer"]
    trainer = L.Trainer(
        accelerator=t["accelerator"],
        devices=1,
        precision=t["precision"],
        max_steps=config["steps"],
        val_check_interval=min(config["validate_every"], config["steps"]),
        limit_val_batches=20,
        check_val_every_n_epoch=None,
        num_sanity_val_steps=0,
        gradient_clip_val=1.0,
        callbacks=[saving, TrainingProgress()],
        logger=CSVLogger(directory, name="logs"),
        log_every_n_steps=20,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    last = directory / "last.ckpt"
    first = int(torch.load(last, weights_only=True)["global_step"]) if last.exists() else 0
    train = PairStream(splits["train"], settings, config["seed"], first)
    trainer.fit(
        module,
        DataLoader(train, batch_size=None, num_workers=t["workers"]),
        DataLoader(PairStream(splits["val"], settings, config["seed"]), batch_size=None),
        ckpt_path=str(last) if last.exists() else None,
        weights_only=True,
    )
    if trainer.global_step < config["steps"]:
        raise KeyboardInterrupt  # Lightning turns the signal into a silent end
    scores = {k: round(float(v), 4) for k, v in trainer.callback_metrics.items() if "val/" in k}
    info = {**origin, "config": portable(config), "scores": scores}
    with atomic_path(output) as temporary:
        save_file(encoder.state_dict(), temporary, {"info": json.dumps(info)})
    last.unlink(missing_ok=True)
    print(f"{output}: {scores}")


if __name__ == "__main__":
    main()
