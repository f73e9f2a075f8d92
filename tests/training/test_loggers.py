"""A logger that cannot work is told in one line, before the training."""

from pathlib import Path
from typing import Any

import pytest
from lightning.fabric.loggers import tensorboard
from lightning.pytorch.loggers import CSVLogger

from tf_lab.config.compose import compose_config
from tf_lab.config.schema import TrainConfig
from tf_lab.errors import TFLabError
from tf_lab.training.loggers import make_loggers


def config(logger: str, *overrides: str) -> TrainConfig:
    return compose_config("train", f"logger={logger}", *overrides)


def test_without_the_tensorboard_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(make_loggers(config("tensorboard"), tmp_path)) == 2
    for name in ("_TENSORBOARD_AVAILABLE", "_TENSORBOARDX_AVAILABLE"):
        monkeypatch.setattr(tensorboard, name, False)
    with pytest.raises(TFLabError, match=r"logger=tensorboard.*pip install tensorboard"):
        make_loggers(config("tensorboard"), tmp_path)
    assert len(make_loggers(config("csv"), tmp_path)) == 1


def test_wandb_without_an_account(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("WANDB_API_KEY", "WANDB_MODE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))  # no ~/.netrc
    monkeypatch.setenv("WANDB_SILENT", "true")
    with pytest.raises(TFLabError, match=r"logger=wandb: .*wandb login.*logger=wandb_offline"):
        make_loggers(config("wandb"), tmp_path)


def test_the_settings_of_wandb_reach_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: dict[str, Any] = {}

    class Made:
        experiment = None

    def make(kind: type, name: str, node: dict[str, Any], /, **arguments: Any) -> Made:
        made.update(node | arguments)
        return Made()

    monkeypatch.setattr("tf_lab.training.loggers.make", make)
    settings = ("logger.project=mine", "+logger.others.log_model=true")
    make_loggers(config("wandb_offline", *settings), tmp_path / "tiny-seed0")
    assert made.pop("config")["logger"]["project"] == "mine"
    assert made == {
        "_target_": "lightning.pytorch.loggers.WandbLogger",
        "project": "mine",
        "offline": True,
        "log_model": True,
        "name": "tiny-seed0",
        "id": "tiny-seed0",
        "save_dir": tmp_path / "tiny-seed0",
    }


def test_a_logger_of_any_class(tmp_path: Path) -> None:
    named = ("logger._target_=lightning.pytorch.loggers.CSVLogger", "+logger.others.name=more")
    _, logger = make_loggers(config("csv", *named), tmp_path)
    assert isinstance(logger, CSVLogger)
    assert logger.log_dir == str(tmp_path / "more" / "version_0")
