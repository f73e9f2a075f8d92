"""A logger that cannot work is told in one line, before the training."""

from pathlib import Path
from typing import Any

import pytest
from lightning.fabric.loggers import tensorboard

from tf_lab.errors import TFLabError
from tf_lab.training.loggers import make_loggers

CSV = {"logger": {"kind": "csv"}}
TENSORBOARD = {"logger": {"kind": "tensorboard"}}
WANDB: dict[str, Any] = {"logger": {"kind": "wandb", "project": "p", "offline": False}}


def test_without_the_tensorboard_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(make_loggers(TENSORBOARD, tmp_path)) == 2
    for name in ("_TENSORBOARD_AVAILABLE", "_TENSORBOARDX_AVAILABLE"):
        monkeypatch.setattr(tensorboard, name, False)
    with pytest.raises(TFLabError, match=r"logger=tensorboard.*pip install tensorboard"):
        make_loggers(TENSORBOARD, tmp_path)
    assert len(make_loggers(CSV, tmp_path)) == 1


def test_wandb_without_an_account(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("WANDB_API_KEY", "WANDB_MODE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))  # no ~/.netrc
    monkeypatch.setenv("WANDB_SILENT", "true")
    with pytest.raises(TFLabError, match=r"logger=wandb: .*wandb login.*logger=wandb_offline"):
        make_loggers(WANDB, tmp_path)
