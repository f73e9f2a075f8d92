"""Pre-train the encoder on the train split by matching: stand-in for, or finish of, ImageNet."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import lightning as L

from tf_lab.config.build import initialise_encoder
from tf_lab.config.schema import PretrainConfig
from tf_lab.config.stored import portable_config
from tf_lab.data.capture import Capture
from tf_lab.data.pairs import PairBatch, PairSettings, PairStream
from tf_lab.data.readers import open_capture
from tf_lab.data.resize import Resized
from tf_lab.data.sources.settings import Content
from tf_lab.data.sources.source import open_source
from tf_lab.errors import TFLabError
from tf_lab.experiments.identity import key_of
from tf_lab.experiments.provenance import provenance
from tf_lab.network.encoders import make_encoder
from tf_lab.network.encoders.pyramid import Encoder
from tf_lab.network.encoders.settings import EncoderSettings
from tf_lab.network.encoders.turning import turn_like
from tf_lab.network.encoders.weights import RANDOM, ROOMS, load_encoder
from tf_lab.support.files import check_file
from tf_lab.support.settings import shaping
from tf_lab.training.datamodule import StreamDataModule
from tf_lab.training.fit import FitSettings
from tf_lab.training.fit_weights import fit_weights, one_device
from tf_lab.training.initial import with_encoder_digest
from tf_lab.training.pretrain_encoder import Matching

VALIDATION = 20  # batches
CLIP = 1.0  # largest gradient norm
TURNED = 25  # batches
CANDIDATES = 200  # points of the second image, among which one of the first is found again


def validation_pairs(scenes: Sequence[Path | Capture], config: PretrainConfig) -> list[PairBatch]:
    """The same pairs every time, as the cameras took them."""
    settings = PairSettings(config.pairs, CANDIDATES, config.epipolar)
    return list(islice(PairStream(scenes, settings, config.seed), VALIDATION))


def run(config: PretrainConfig) -> None:
    """Pre-train, validate on the val split, write the encoder with its provenance."""
    output, origin = Path(config.output), provenance()
    makes = config.steps > 0 or config.like is not None
    if makes:
        check_file(output)
    L.seed_everything(config.seed, verbose=False)
    needed = ("train", "val") if makes else ("val",)
    made: dict[str, dict[str, Path]] = {"train": {}, **open_source(config.data).scenes(*needed)}
    splits = {split: [*scenes.values()] for split, scenes in made.items()}
    encoder, trunk_factor = _encoder(config)
    validated: dict[str, Sequence[Path | Capture]] = {"val": splits["val"]}
    if config.real is not None:
        validated["real"] = [_real(config)]
    finish = None
    if config.like is not None:
        finish = partial(_turn, encoder, _other(config, config.like), splits["train"], config.seed)
    module = Matching(
        encoder, config.lr, trunk_factor, config.steps, config.temperature, [*validated]
    )
    settings = PairSettings(config.pairs, config.points, config.epipolar, jitter=config.jitter)

    def pairs(first_step: int) -> PairStream:
        return PairStream(splits["train"], settings, config.seed, first_step, config.augment)

    def data() -> StreamDataModule[PairBatch]:
        val = [validation_pairs(scenes, config) for scenes in validated.values()]
        return StreamDataModule(pairs, val, config.trainer.workers)

    every = config.validate_every
    fit_weights(
        encoder,
        module,
        data,
        output,
        config.trainer,
        FitSettings(config.steps, every, every, CLIP, less="fewer pairs"),
        _identity(config, splits["train"]),
        [*validated],
        {**origin, "config": _portable(config)},
        finish,
    )


def _other(config: PretrainConfig, file: str) -> Encoder:
    """The encoder whose features ours are to be like, which is of the same settings."""
    other = make_encoder(**config.encoder.architecture())
    load_encoder(other, Path(file))
    return other


def _turn(encoder: Encoder, other: Encoder, scenes: Sequence[Path], seed: int) -> None:
    images = PairStream(scenes, PairSettings(points=1, epipolar=0), seed)
    similar = turn_like(encoder, other, (b.images.flatten(0, 1) for b in islice(images, TURNED)))
    print("cosine to the other's features:", {k: round(v, 3) for k, v in similar.items()})


def _identity(config: PretrainConfig, scenes: Sequence[Path]) -> str:
    """Of all that shapes the encoder: settings, the weights that it starts from, and scenes.

    A scene's directory and the two above it say what it was made of, and how.
    """
    settings = shaping(replace(config, trainer=one_device(config.trainer)), "weights")
    start = with_encoder_digest(_start(config), config.model.name, Content()).encoder
    like = config.like and hashlib.sha256(Path(config.like).read_bytes()).hexdigest()
    return key_of(settings, start, [path.parts[-3:] for path in scenes], *filter(None, [like]))


def _portable(config: PretrainConfig) -> dict[str, Any]:
    """The config without the paths of this machine: of its files, the names."""
    named = replace(config.encoder, weights=Path(config.encoder.weights).name)
    files = {name: (path := getattr(config, name)) and Path(path).name for name in ("real", "like")}
    return {**portable_config(replace(config, encoder=named)), **files}


def _start(config: PretrainConfig) -> EncoderSettings:
    """The encoder's settings with the weights that it starts from.

    ``encoder.weights=rooms`` is what is made here, and starts from none, unless it is scored.
    """
    made = config.encoder.weights == ROOMS and config.steps
    return replace(config.encoder, weights=RANDOM) if made else config.encoder


def _encoder(config: PretrainConfig) -> tuple[Encoder, float]:
    """The encoder as it starts, and its trunk's learning rate over the others'."""
    settings = _start(config)
    encoder = make_encoder(**settings.architecture())
    initialise_encoder(encoder, settings, config.model.name)
    factor = config.trunk_factor
    frozen = settings.weights == encoder.PUBLISHED
    return encoder, (0.0 if frozen else 1.0) if factor is None else factor


def _real(config: PretrainConfig) -> Capture:
    """The capture ``real`` at the size of the training's images.

    Raises:
        TFLabError: it cannot be opened, or has no depth.
    """
    capture = open_capture(Path(str(config.real)))
    if capture.depth(0) is None:
        raise TFLabError(f"real={config.real}: it has no depth, which says what corresponds")
    return Resized(capture, (config.data.width, config.data.height))
