"""Pre-train the encoder on the train split by matching: stand-in for, or finish of, ImageNet."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from safetensors.torch import save_file
from torch import Tensor
from torch.utils.data import DataLoader

from tf_lab.config.build import initialise_encoder
from tf_lab.config.schema import PretrainConfig
from tf_lab.config.stored import portable_config
from tf_lab.data.capture import Capture
from tf_lab.data.pairs import PairBatch, PairSettings, PairStream
from tf_lab.data.readers import open_capture
from tf_lab.data.resize import Resized
from tf_lab.data.sources.source import open_source
from tf_lab.errors import TFLabError
from tf_lab.experiments.provenance import provenance, without_places
from tf_lab.network.encoders import make_encoder
from tf_lab.network.encoders.pyramid import Encoder
from tf_lab.support.files import atomic_path, check_file
from tf_lab.training.matching import matching_loss
from tf_lab.training.module import TrainingProgress

VALIDATION = 20  # batches
CANDIDATES = 200  # points of the second image, among which one of the first is found again


class Matching(L.LightningModule):
    """Trains an encoder so that both its maps tell corresponding pixels from others.

    Args:
        encoder: trained in place.
        lr: peak learning rate of the pyramid.
        trunk_factor: the trunk's over it; 0: the trunk stays as it is.
        steps: in all.
        temperature: of the softmax over candidates.
        sets: names of what is validated on, one a loader.
    """

    def __init__(
        self,
        encoder: Encoder,
        lr: float,
        trunk_factor: float,
        steps: int,
        temperature: float,
        sets: Sequence[str],
    ) -> None:
        super().__init__()
        self.encoder, self.lr, self.steps = encoder, lr, steps
        self.trunk_factor, self.temperature, self.sets = trunk_factor, temperature, sets
        for parameter in encoder.trunk_parameters():
            parameter.requires_grad_(trunk_factor > 0)

    def _losses(self, batch: PairBatch) -> dict[str, Tensor]:
        size = (batch.images.shape[-1], batch.images.shape[-2])
        maps = self.encoder(batch.images.flatten(0, 1))
        terms: dict[str, Tensor] = {}
        with torch.autocast(self.device.type, enabled=False):  # the best of many needs digits
            for name, level in zip(("coarse", "fine"), maps, strict=True):
                pairs = level.float().unflatten(0, (-1, 2))
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

    def validation_step(self, batch: PairBatch, batch_idx: int, dataloader_idx: int = 0) -> None:
        """The same on scenes never trained on; the best match of P + E candidates."""
        terms = {f"{self.sets[dataloader_idx]}/{k}": v for k, v in self._losses(batch).items()}
        self.log_dict(terms, batch_size=1, add_dataloader_idx=False)

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Adam, short warm-up, cosine to zero."""
        trunk = [p for p in self.encoder.trunk_parameters() if p.requires_grad]
        groups: list[dict[str, Any]] = [{"params": list(self.encoder.pyramid_parameters())}]
        groups += [{"params": trunk, "lr": self.lr * self.trunk_factor}] if trunk else []
        adam = torch.optim.Adam(groups, self.lr)

        def factor(step: int) -> float:
            return min(1, (step + 1) / 50) * 0.5 * (1 + math.cos(math.pi * step / self.steps))

        schedule = torch.optim.lr_scheduler.LambdaLR(adam, factor)
        return {"optimizer": adam, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def validation_pairs(
    scenes: Sequence[Path | Capture], config: PretrainConfig
) -> DataLoader[PairBatch]:
    """The same pairs every time, as the cameras took them."""
    settings = PairSettings(config.pairs, CANDIDATES, config.epipolar)
    pairs = islice(PairStream(scenes, settings, config.seed), VALIDATION)
    return DataLoader(list(pairs), batch_size=None)  # type: ignore[arg-type]


def run(config: PretrainConfig) -> None:
    """Pre-train, validate on the val split, write the encoder with its provenance."""
    output, origin = Path(config.output), provenance()
    check_file(output)
    L.seed_everything(config.seed, verbose=False)
    made = open_source(config.data).scenes("train", "val")
    splits = {split: [*scenes.values()] for split, scenes in made.items()}
    encoder, trunk_factor = _encoder(config)
    validated: dict[str, Sequence[Path | Capture]] = {"val": splits["val"]}
    if config.real is not None:
        validated["real"] = [_real(config)]
    module = Matching(
        encoder, config.lr, trunk_factor, config.steps, config.temperature, [*validated]
    )
    directory = output.with_suffix("")
    settings = PairSettings(config.pairs, config.points, config.epipolar, jitter=config.jitter)
    saving = ModelCheckpoint(
        directory,
        filename="last",
        every_n_train_steps=config.validate_every,
        enable_version_counter=False,
        save_on_train_epoch_end=False,
    )
    t = config.trainer
    trainer = L.Trainer(
        accelerator=t.accelerator,
        devices=1,
        precision=t.precision,  # type: ignore[arg-type]  # Lightning says what it takes
        max_steps=config.steps,
        val_check_interval=min(config.validate_every, config.steps),
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
    train = PairStream(splits["train"], settings, config.seed, first, config.augment)
    trainer.fit(
        module,
        DataLoader(train, batch_size=None, num_workers=t.workers),
        [validation_pairs(scenes, config) for scenes in validated.values()],
        ckpt_path=str(last) if last.exists() else None,
        weights_only=True,
    )
    if trainer.global_step < config.steps:
        raise KeyboardInterrupt  # Lightning turns the signal into a silent end
    scores = {
        name: round(float(value), 4)
        for name, value in trainer.callback_metrics.items()
        if name.partition("/")[0] in validated
    }
    info = without_places({**origin, "config": _portable(config), "scores": scores})
    with atomic_path(output) as temporary:
        save_file(encoder.state_dict(), temporary, {"info": json.dumps(info)})
    last.unlink(missing_ok=True)
    print(f"{output}: {scores}")


def _portable(config: PretrainConfig) -> dict[str, Any]:
    """The config without the paths of this machine: of its files, the names."""
    named = replace(config.encoder, weights=Path(config.encoder.weights).name)
    real = config.real and Path(config.real).name
    return {**portable_config(replace(config, encoder=named)), "real": real}


def _encoder(config: PretrainConfig) -> tuple[Encoder, float]:
    """The encoder with the weights it starts from, and its trunk's learning rate over the others'.

    ``encoder.weights=rooms`` is what is made here, and starts from none.
    """
    settings = config.encoder
    if settings.weights == "rooms":
        settings = replace(settings, weights="none")
    encoder = make_encoder(**settings.architecture())
    initialise_encoder(encoder, settings, config.model.name)
    factor = config.trunk_factor
    return encoder, (0.0 if settings.weights == "imagenet" else 1.0) if factor is None else factor


def _real(config: PretrainConfig) -> Capture:
    """The capture ``real`` at the size of the training's images.

    Raises:
        TFLabError: it cannot be opened, or has no depth.
    """
    capture = open_capture(Path(str(config.real)))
    if capture.depth(0) is None:
        raise TFLabError(f"real={config.real}: it has no depth, which says what corresponds")
    return Resized(capture, (config.data.width, config.data.height))
