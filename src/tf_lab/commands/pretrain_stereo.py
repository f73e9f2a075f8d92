"""Train what reads depth from the scores of a plane sweep, on scenes whose depth is known."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import lightning as L
import numpy as np

from tf_lab.config.schema import PretrainStereoConfig
from tf_lab.config.stored import portable_config
from tf_lab.data.keyframes import select_keyframes
from tf_lab.data.plane_sweeps import SweepBatch, SweepDraws, SweepStream, every_sweep
from tf_lab.data.readers import open_capture
from tf_lab.data.sources.source import open_source
from tf_lab.errors import TFLabError
from tf_lab.experiments.identity import key_of
from tf_lab.experiments.provenance import provenance
from tf_lab.stereo.depth import SETTINGS, VERSION
from tf_lab.stereo.regularizer import Regularizer
from tf_lab.support.files import check_file
from tf_lab.support.settings import shaping
from tf_lab.training.datamodule import StreamDataModule
from tf_lab.training.fit import FitSettings
from tf_lab.training.fit_weights import fit_weights, one_device
from tf_lab.training.pretrain_stereo import DepthTraining

MOST = 60  # frames of a capture that are validated on
CLIP = 1.0  # largest gradient norm


def run(config: PretrainStereoConfig) -> None:
    """Train, validate on the val split, write the weights with their provenance."""
    output, origin = Path(config.output), provenance()
    check_file(output)
    L.seed_everything(config.seed, verbose=False)
    made = open_source(config.data).scenes("train", "val")
    train = [*made["train"].values()]
    validated = {"val": [f for path in made["val"].values() for f in _sweeps(path)]}
    if config.real is not None:
        validated["real"] = _sweeps(Path(config.real))
    regularizer = Regularizer()
    module = DepthTraining(regularizer, SETTINGS, config.lr, config.steps, [*validated])
    draws = SweepDraws(config.frames, config.camera_noise, config.augment)

    def data() -> StreamDataModule[SweepBatch]:
        return StreamDataModule(
            lambda step: SweepStream(train, SETTINGS, draws, config.seed, step),
            [*validated.values()],
            config.trainer.workers,
        )

    every = config.validate_every
    real = config.real and Path(config.real).name
    fit_weights(
        regularizer,
        module,
        data,
        output,
        config.trainer,
        FitSettings(config.steps, every, every, CLIP, less="fewer frames"),
        _identity(config, train),
        [*validated],
        {**origin, "config": {**portable_config(config), "real": real}},
    )


def _sweeps(path: Path) -> list[SweepBatch]:
    """Some keyframes of a scene or a capture, evenly chosen, against the keyframes before them.

    Raises:
        TFLabError: it cannot be opened, or no frame of it has depth and sources.
    """
    capture = open_capture(path)
    keyframes = select_keyframes(capture.world_T_cam)
    spread = np.linspace(0, len(keyframes) - 1, min(MOST, len(keyframes))).round().astype(int)
    chosen = [keyframes[i] for i in spread]
    found = every_sweep(capture, keyframes, chosen, SETTINGS)
    if not found:
        raise TFLabError(f"{path}: no frame of it has depth, and others to be compared with")
    return found


def _identity(config: PretrainStereoConfig, scenes: list[Path]) -> str:
    """Of all that shapes the weights: settings and scenes.

    A scene's directory and the two above it say what it was made of, and how.
    """
    settings = shaping(replace(config, trainer=one_device(config.trainer)), "weights")
    sweeps = [VERSION, asdict(SETTINGS)]
    return key_of(settings, sweeps, [path.parts[-3:] for path in scenes])
