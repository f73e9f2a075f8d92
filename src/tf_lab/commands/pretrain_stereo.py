"""Train what reads depth from the scores of a plane sweep, on scenes whose depth is known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import lightning as L
from lightning.pytorch.loggers import CSVLogger
from safetensors.torch import save_file

from tf_lab.config.schema import PretrainStereoConfig
from tf_lab.config.stored import portable_config
from tf_lab.data.keyframes import select_keyframes
from tf_lab.data.readers import open_capture
from tf_lab.data.scene import Scene
from tf_lab.data.sources.source import open_source
from tf_lab.data.sweeps import SweepBatch, SweepDraws, SweepStream, every_sweep
from tf_lab.errors import TFLabError
from tf_lab.experiments.identity import key_of
from tf_lab.experiments.provenance import provenance, without_places
from tf_lab.stereo.depth import SETTINGS, VERSION
from tf_lab.stereo.regularizer import Regularizer
from tf_lab.support.files import atomic_path, check_file
from tf_lab.support.settings import shaping
from tf_lab.training.datamodule import StreamDataModule
from tf_lab.training.depth import DepthTraining
from tf_lab.training.fit import LAST, FitSettings, fit, rank_zero_lock

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

    directory, every = output.with_suffix(""), config.validate_every
    with rank_zero_lock(directory, "pre-training"):
        trainer = fit(
            module,
            data,
            directory,
            replace(config.trainer, devices=1, strategy="auto"),
            FitSettings(config.steps, every, every, CLIP, _identity(config, train)),
            loggers=[CSVLogger(directory, name="logs")],
        )
        scores = {
            name: round(float(value), 4)
            for name, value in trainer.callback_metrics.items()
            if name.partition("/")[0] in validated
        }
        real = config.real and Path(config.real).name
        portable = {**portable_config(config), "real": real}
        info = without_places({**origin, "config": portable, "scores": scores})
        with atomic_path(output) as temporary:
            save_file(regularizer.state_dict(), temporary, {"info": json.dumps(info)})
        (directory / LAST).unlink(missing_ok=True)
    print(f"{output}: {scores}")


def _sweeps(path: Path) -> list[SweepBatch]:
    """Some keyframes of a scene or a capture, evenly chosen, against the keyframes before them.

    Raises:
        TFLabError: it cannot be opened, has no depth, or no frame of it has sources.
    """
    capture = Scene(path) if (path / "scene.json").is_file() else open_capture(path)
    if capture.depth(0) is None:
        raise TFLabError(f"{path}: it has no depth, which says what stereo should find")
    keyframes = select_keyframes(capture.world_T_cam)
    chosen = keyframes[:: max(1, len(keyframes) // MOST)]
    found = every_sweep(capture, keyframes, chosen, SETTINGS)
    if not found:
        raise TFLabError(f"{path}: no frame of it has others to be compared with")
    return found


def _identity(config: PretrainStereoConfig, scenes: list[Path]) -> str:
    """Of all that shapes the weights: settings and scenes.

    A scene's directory and the two above it say what it was made of, and how.
    """
    return key_of(shaping(config, "weights"), VERSION, [path.parts[-3:] for path in scenes])
